"""The contract between the simulator and the agents: messages, keys, life cycle, and the one door to Zenoh."""

from __future__ import annotations

PROTOCOL_VERSION = 2
"""Version of everything in this package that another program can see. Any change to a message raises it."""
