"""What can be wrong on the wire. A peer's fault and our own misuse are two classes."""

from __future__ import annotations

from enum import StrEnum


class Reason(StrEnum):
    """Why a message was refused. The value is what is counted, reported and sent back."""

    MALFORMED = "malformed"
    VERSION = "version"
    TYPE = "type"
    MISSING_FIELD = "missing_field"
    UNKNOWN_FIELD = "unknown_field"
    FIELD_TYPE = "field_type"
    LENGTH = "length"
    NOT_FINITE = "not_finite"
    RANGE = "range"
    ARM = "arm"
    RUN = "run"
    ROLE = "role"
    MODEL = "model"
    DIGEST = "digest"
    TAKEN = "taken"
    LEASE = "lease"
    PHASE = "phase"
    STALE = "stale"
    FUTURE = "future"
    DUPLICATE = "duplicate"
    POINT = "point"


class WireError(Exception):
    """Base of everything that this package raises.

    Those that are not our own misuse carry ``exit_status``: what a command line that ends with them exits with (2 bad
    input, 3 could not run).
    """


class Refused(WireError):
    """The peer's fault: a message that does not fit. It is counted, reported, and changes nothing.

    Attributes:
        reason: the kind of misfit.
        what: the field or thing at fault.
        got, expected: what came and what would have been right, as text.
    """

    exit_status = 2

    def __init__(self, reason: Reason, what: str, got: object = "", expected: object = "", fix: str = "") -> None:
        self.reason, self.what, self.got, self.expected = reason, what, str(got), str(expected)
        text = f"{reason}: {what[:80]}"
        if self.got:
            text += f": got {self.got[:80]}"
        if self.expected:
            text += f", expected {self.expected}"
        if fix:
            text += f". {fix}"
        super().__init__(text)


class MisuseError(WireError):
    """Our own fault: the program called this package in a way that its state does not allow."""


class LinkError(WireError):
    """The link could not be opened or used: port in use, nobody there, bad address."""

    exit_status = 3

    def __init__(self, text: str, *, exit_status: int = 3) -> None:
        self.exit_status = exit_status
        super().__init__(text)


class LoginRefused(LinkError):
    """Somebody listens there but does not let this credential in."""

    def __init__(self, text: str) -> None:
        super().__init__(text, exit_status=2)


class CredentialError(WireError):
    """A credential is not there, not usable, or somebody else's."""

    exit_status = 2
