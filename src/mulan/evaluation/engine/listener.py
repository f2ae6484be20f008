"""How a benchmark tells the person who waits what it does and what it found."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Listener:
    """Follows a benchmark.

    Attributes:
        say: Called with each result, in a few words.
        begin: Called with the title of each stage; what it returns is called with what is done, the total,
            and a few words on the latest state.
    """

    say: Callable[[str], object]
    begin: Callable[[str], Callable[[float, float, str], None]]
