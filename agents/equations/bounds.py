"""Bounds, written so that symbols (agents/tracing.py) can pass them too: no comparison, no branch. (Ours.)"""

from __future__ import annotations

from typing import Any


def limited(x: Any, low: Any, high: Any) -> Any:
    """``x`` between ``low`` and ``high``, element by element: (low + high + |x - low| - |x - high|) / 2.

    Args:
        low, high: low <= high.
    """
    return 0.5 * (low + high + (abs(x - low) - abs(x - high)))
