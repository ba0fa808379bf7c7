"""Check of estimates as they arrive: an estimator may be a user's own, and return anything."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Final

import numpy as np

from estimators.estimates import Health

_TYPES: Final[dict[object, tuple[type, ...]]] = {
    "int": (int, np.integer),
    "float": (float, int, np.floating, np.integer),
    "Health": (Health,),
}


def check_estimate(estimate: object, kinds: tuple[type, ...]) -> None:
    """Refuse anything but an estimate of these kinds with numbers in its numeric fields; NaN is a number.

    Raises:
        TypeError: one line with the wrong value.
    """
    if not isinstance(estimate, kinds):
        raise TypeError(f"returned {estimate!r}, not {' or '.join(kind.__name__ for kind in kinds)}")
    _check_fields(estimate)


def _check_fields(estimate: object) -> None:
    if not is_dataclass(estimate):
        return
    for field in fields(estimate):
        value = getattr(estimate, field.name)
        types = _TYPES.get(field.type)
        if types and not isinstance(value, types):
            raise TypeError(f"returned {type(estimate).__name__}.{field.name} = {value!r}, not {field.type}")
        _check_fields(value)
