"""The agents' errors: what, where, got, expected, what to do next."""

from __future__ import annotations


class AgentError(Exception):
    """Base of every error that the agents' side raises on purpose."""


class ControllerError(AgentError):
    """A controller is unknown, its settings are wrong, or what it returned cannot be used."""


class NotWelcome(AgentError):
    """The simulator refused to let this agent in."""
