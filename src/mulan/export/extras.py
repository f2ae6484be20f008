"""Libraries that only some exports need, imported when they are."""

import importlib
from types import ModuleType

from mulan.errors import InputError


def extra_module(name: str, package: str, needed_for: str) -> ModuleType:
    """Import a module of the ``export`` extra.

    Raises:
        InputError: It is not installed; the sentence says how to get it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputError(
            needed_for, f"package '{package}'", f"is missing ({error})", "run: pip install 'mulan[export]'"
        ) from error
