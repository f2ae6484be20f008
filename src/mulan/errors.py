"""The one exception a user may see: what is wrong, where, and what to do about it."""

from pathlib import Path


class InputError(Exception):
    """Input that cannot be used, told in one sentence.

    Attributes:
        source: File (or topic, or option) at fault.
        field: What inside it is wrong.
        remedy: What the user can do.
    """

    def __init__(self, source: str | Path, field: str, problem: str, remedy: str) -> None:
        self.source = str(source)
        self.field = field
        self.problem = problem
        self.remedy = remedy
        super().__init__(f"{self.source}: {field}: {problem}; {remedy}.")

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str, str]]:
        """Worker processes raise it too."""
        return InputError, (self.source, self.field, self.problem, self.remedy)
