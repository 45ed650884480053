"""The agents' errors: what, where, got, expected, what to do next."""

from __future__ import annotations


class AgentError(Exception):
    """Base of every error that the agents' side raises on purpose.

    Attributes:
        exit_status: what a command line that ends with this error exits with (2 bad input, 3 could not run).
    """

    exit_status = 3


class ControllerError(AgentError):
    """A controller is unknown, its settings are wrong, or what it returned cannot be used."""

    exit_status = 2
    caused_by_user_code = True
    """The cause, if there is one, was raised by somebody's own controller."""


class GainError(ControllerError):
    """A gain is not what its law takes.

    Attributes:
        key: its name.
        problem: what is wrong, without controller and key.
    """

    def __init__(self, controller: str, key: str, problem: str) -> None:
        self.key, self.problem = key, problem
        super().__init__(f"controller {controller}: gain {key}: {problem}")


class NotWelcome(AgentError):
    """The simulator refused to let this agent in."""

    exit_status = 2
