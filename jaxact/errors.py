"""One clear sentence for bad input: what was given, what was expected, the nearest valid choice."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from numbers import Integral


class JaxactError(ValueError):
    """Bad input that the user can mend; command lines print its message without a traceback."""


def unknown(kind: str, given: str, valid: Iterable[str]) -> JaxactError:
    """Returns the error for a name that is not among the valid ones.

    >>> str(unknown("loss", "pppo", ["ppo", "a2c"]))
    "unknown loss 'pppo'; the nearest is 'ppo' (valid: a2c, ppo)"
    """
    names = sorted(valid)
    close = difflib.get_close_matches(str(given), names, n=1, cutoff=0.0)
    nearest = f"the nearest is {close[0]!r}" if close else "there is no valid choice"
    shown = ", ".join(names[:12]) + (f", and {len(names) - 12} more" if len(names) > 12 else "")
    return JaxactError(f"unknown {kind} {given!r}; {nearest} (valid: {shown})")


def check_at_least(least: int, what: str, **numbers: int) -> None:
    """Refuses numbers that are not whole or too small.

    Args:
      least: the smallest that will do.
      what: whose they are.
      **numbers: by name.

    Raises:
      JaxactError: one is smaller, or is not whole.
    """
    for name, number in numbers.items():
        if not isinstance(number, Integral):
            raise JaxactError(f"{name} of {what} must be a whole number, got {number!r}")
        if number < least:
            raise JaxactError(f"{name} of {what} must be at least {least}, got {number}")
