"""What a router's configuration has to be before a router starts with it: one of ours, with its rules, and private."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from wire.endpoints import Endpoint, check_stays_here_or_is_proven, parse_endpoint
from wire.private_files import read_private

PASSWORDS = "transport/auth/usrpwd/dictionary_file"
MUTUAL_TLS = "transport/link/tls/enable_mtls"
RULES = {"mode": "peer", "access_control/enabled": True, "access_control/default_permission": "deny"}
"""What every file that `palanquin credentials --router-config` wrote says. Without it, everybody may do everything."""


def check_router_config(value_of: Callable[[str], str]) -> Endpoint:
    """The one address at which the router will listen.

    Args:
        value_of: the configuration's value at a path, as JSON.

    Raises:
        ValueError: it is not one of ours.
        LinkError: the address is bad, or other machines could use it without certificates.
        CredentialError: others may read the file with the passwords, or it cannot be read.
    """

    def value(path: str) -> Any:
        return json.loads(value_of(path))

    for path, expected in RULES.items():
        if value(path) != expected:
            raise ValueError(f"{path} is {json.dumps(value(path))}, expected {json.dumps(expected)}")
    listen, connect = value("listen/endpoints"), value("connect/endpoints")
    if not isinstance(listen, list) or len(listen) != 1 or connect != []:
        raise ValueError("expected one address in listen/endpoints and none in connect/endpoints")
    address = parse_endpoint(str(listen[0]))
    check_stays_here_or_is_proven(address, has_credentials=True)
    if address.protocol == "tls" and value(MUTUAL_TLS) is not True:
        raise ValueError(f"{MUTUAL_TLS} is {json.dumps(value(MUTUAL_TLS))}, expected true")
    passwords = value(PASSWORDS)
    if not isinstance(passwords, str):
        raise ValueError(f"{PASSWORDS} is {json.dumps(passwords)}, expected the file with the passwords")
    read_private(Path(passwords))
    return address
