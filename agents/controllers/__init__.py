"""Control laws, chosen by name or as ``module:Class``."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, cast

from pydantic import ValidationError

from agents.arm_model import ArmModel
from agents.controllers.interface import Controller, ControllerFactory
from agents.controllers.palanquin import PalanquinController
from agents.controllers.paper import PaperController
from agents.errors import ControllerError, GainError

CONTROLLERS: Mapping[str, ControllerFactory] = {
    "paper": PaperController,
    "palanquin": PalanquinController,
}
"""The laws that come with Palanquin."""


def find_controller(name: str) -> ControllerFactory:
    """The law of that name, or the class at ``module:Class``.

    Raises:
        ControllerError: there is none; the message names the known ones.
    """
    if name in CONTROLLERS:
        return CONTROLLERS[name]
    module_name, colon, class_name = name.partition(":")
    if not (colon and all(part.isidentifier() for part in module_name.split("."))):
        raise ControllerError(
            f"controller {name!r} is unknown: expected one of {', '.join(CONTROLLERS)}, or module:Class for your own"
        )
    try:
        found: Any = getattr(importlib.import_module(module_name), class_name, None)
    except ImportError as error:
        raise ControllerError(
            f"controller {name!r}: module {module_name!r} cannot be imported ({error}); it must be on PYTHONPATH"
        ) from None
    if not callable(found):
        raise ControllerError(f"controller {name!r}: module {module_name!r} has no class {class_name!r}")
    return cast(ControllerFactory, found)


def make_controller(name: str, arm: ArmModel, gains: Mapping[str, object]) -> Controller:
    """Build the law ``name`` for ``arm`` with ``gains``.

    Raises:
        ControllerError: unknown law, unknown gain, or a gain of the wrong kind.
    """
    factory = find_controller(name)
    try:
        controller = factory(arm, **gains)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "gains"
        known = ", ".join(getattr(getattr(factory, "gains_model", None), "model_fields", {}))
        problem = f"{first['msg']}; got {first['input']!r}" + (f"; known gains: {known}" if known else "")
        raise GainError(name, key, problem) from None
    except ControllerError as error:
        raise ControllerError(f"controller {name}: {error}") from error.__cause__
    except TypeError as error:
        raised_inside = error.__traceback__ is not None and error.__traceback__.tb_next is not None
        raise ControllerError(f"controller {name}: {error}; got gains {dict(gains)!r}") from (
            error if raised_inside else None  # gains that the constructor does not take are no bug of its code
        )
    except Exception as error:  # a user's code may raise anything; the cause goes to the log with its traceback
        raise ControllerError(
            f"controller {name} cannot be made: {type(error).__name__}: {error}; got gains {dict(gains)!r}"
        ) from error
    if not callable(getattr(controller, "step", None)):
        raise ControllerError(f"controller {name}: got a {type(controller).__name__}, which has no method `step`")
    return controller
