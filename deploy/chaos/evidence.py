"""What an intruder could not see itself: whether its messages arrived, from the folder of the run that it attacked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from deploy.chaos.attempt import Got
from deploy.chaos.intruder import Row
from sim_server.run_folder import LOGS, read_audit, read_run
from wire.errors import Reason
from wire.keys import Keys

FALSE_STATE = "refused a message of the simulator"
"""What a follower logs when something reaches its state key that does not fit (agents/session.py)."""
NOT_COUNTED = (Reason.LENGTH,)
"""Zenoh itself drops what is too long for a key with a limit, so the simulator need not have refused any."""


def settle(rows: list[Row], folder: Path, target_run: str, own: str) -> list[Row]:
    """The rows with ``is_open`` decided, except where nothing was tested.

    Raises:
        RunFolderError: the run left no folder.
    """
    counts = {(row["key"], row["direction"]): row["messages"] for row in read_audit(folder)["counts"]}
    agents = read_run(folder)["agents"]
    surplus = {key: _surplus(key, counts, Keys(target_run), agents) for key in {row.got.edge for row in rows} - {""}}
    return [replace(row, got=_settled(row.got, folder, surplus, agents, own)) for row in rows]


def _settled(
    got: Got, folder: Path, surplus: Mapping[str, int], agents: Mapping[str, Mapping[str, Any]], own: str
) -> Got:
    if got.is_open is not None or not got.tested:
        return got
    if got.edge:
        calm = all(map(_unharmed, agents.values()))
        said = f"{got.evidence}; {surplus[got.edge]} arrived"
        return replace(got, is_open=surplus[got.edge] > 0, evidence=said, only_heard=calm)
    if got.log:
        log = (folder / LOGS / f"{got.log}.log").read_text(encoding="utf-8", errors="replace")
        arrived = FALSE_STATE in log
        return replace(got, is_open=arrived, evidence=f"{got.evidence}; {'it arrived' if arrived else 'none arrived'}")
    agent = agents[own]
    refused = min(agent["refused"].get(got.refused, 0), got.sent)
    in_silence = refused == 0 and got.refused not in NOT_COUNTED  # taken, or lost: nobody can say that it was refused
    harm = "its own arm went on" if _unharmed(agent) else f"its own arm is {agent['phase']}"
    said = f"{got.evidence}; {refused} refused as {got.refused}, {harm}"
    return replace(got, is_open=in_silence or not _unharmed(agent), evidence=said)


def _unharmed(agent: Mapping[str, Any]) -> bool:
    return bool(agent["phase"] == "ticking" and agent["missed_ticks"] == 0)


def _surplus(
    key: str, counts: Mapping[tuple[str, str], int], keys: Keys, agents: Mapping[str, Mapping[str, Any]]
) -> int:
    """Messages at the edge beyond what the owner of the key sent: one answer to a state, one token to an instance."""
    came = counts.get((key, "from"), 0)
    for name, agent in agents.items():
        its = keys.leader if name == "leader" else keys.arm(name)
        if key == its.command:
            return max(0, came - counts.get((its.state, "to"), 0))
        if key == its.alive:
            return max(0, came - int(agent["lease"]))
    return came  # orders: the launcher gives none in a run that ends by itself
