"""A run that is staged for an attack: open, behind passwords, or behind certificates; with or without an intruder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from deploy.chaos.attempt import Got
from deploy.chaos.evidence import settle
from deploy.chaos.intruder import Row
from deploy.credential_store import CA, CA_KEY, CredentialStore
from deploy.exit_status import COULD_NOT_RUN
from deploy.launcher import Launcher, child_environment
from deploy.room import room_environment
from sim_server.run_folder import EVENTS
from sim_server.scenario import Scenario
from wire.credentials import CREDENTIAL, for_one_run
from wire.zenoh_config import client_config

RUN = "carry"
START_S, ATTACK_S, END_S = 60.0, 120.0, 240.0
Tell = Callable[[str], None]


class StageFailed(Exception):
    """The run that was to be attacked did not come about, or not to its end."""

    exit_status = COULD_NOT_RUN


class Staged(Launcher):
    """A launched run whose credentials are files of a store; without a store it is open, and nobody has walls."""

    def __init__(
        self, arguments: list[str], scenario: Scenario, endpoint: str, folder: Path, store: CredentialStore | None
    ) -> None:
        super().__init__(arguments, scenario, RUN, endpoint, folder, for_one_run(()))
        self._store = store

    def _sim_access(self) -> tuple[list[str], bytes]:
        return (["--credentials", str(self._store.folder / "sim")] if self._store else ["--open"]), b""

    def _agent_access(self, name: str) -> tuple[list[str], bytes]:
        return (["--walls", "--credential", str(self._store.folder / name)] if self._store else []), b""

    def attack(self, tell: Tell) -> list[Row]:
        """Let the intruder try everything with the first arm's credential, then end the run; every row decided."""
        own, *others = self._scenario.arms
        self._wait(lambda: '"started"' in self._text(EVENTS), START_S, "the first tick")
        arguments = ["chaos", "attack", "--arm", own, "--run", RUN, "--connect", self._endpoint]
        arguments += [word for name in others for word in ("--other", name)]
        arguments += [
            word for child in self._children if child.name != own for word in ("--pid", str(child.process.pid))
        ]
        arguments += [word for file in self._private_files() for word in ("--private", str(file))]
        proof: dict[str, Any] = {}
        if self._store is not None:
            proof = {"transport": client_config(self._endpoint, self._store.credential(own))["transport"]}
            arguments += ["--overlay", "-", "--walls"]
        rows = [Row(each.pop("name"), each.pop("way"), Got(**each)) for each in self._tries(arguments, proof, tell)]
        if self.sim.process.poll() is not None:
            raise StageFailed(f"the run ended before the attack was over: {self.sim.last_words()}")
        self.sim.process.terminate()  # in order: it writes its folder
        self.wait_for_the_end()
        return settle(rows, self._folder, RUN, own)

    def wait_for_the_end(self) -> None:
        """Until the simulator has ended by itself."""
        self._wait(lambda: self.sim.process.poll() is not None, END_S, "the simulator to end")

    def _private_files(self) -> list[Path]:
        files = [self._folder / EVENTS]
        if self._store is not None:
            names = [*self._scenario.arms[1:], "leader", "sim"]
            files += [self._store.folder / name / CREDENTIAL for name in names]
            files.append(self._store.folder / CA / CA_KEY)
        return files

    def _tries(self, arguments: list[str], proof: dict[str, Any], tell: Tell) -> list[dict[str, Any]]:
        """The intruder's process from start to end; each row as it says it."""
        room, rows = self._rooms.make(), []
        log = self._logs / "intruder.log"
        deadline = time.monotonic() + ATTACK_S
        with log.open("wb") as errors:
            process = subprocess.Popen(
                [sys.executable, "-m", "deploy.cli", *arguments],
                cwd=room,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                start_new_session=True,
                env=child_environment(room_environment(os.environ, room, Path.cwd())),
                text=True,
            )
        watchdog = threading.Timer(ATTACK_S, process.kill)  # it may fall silent, and then no line ever wakes us
        watchdog.start()
        try:
            if process.stdin is None or process.stdout is None:
                raise StageFailed("the intruder has no pipes")
            with suppress(BrokenPipeError), process.stdin as secret:  # it has ended already, and its log says why
                secret.write(json.dumps(proof) + "\n")
            for line in process.stdout:
                rows.append(json.loads(line))
                tell(f"{len(rows)}: {rows[-1]['name']}")
            status = process.wait()
            if time.monotonic() > deadline:
                raise StageFailed(f"the attack took more than {ATTACK_S:g} s; its log is {log}")
            if status:
                raise StageFailed(f"the intruder ended with {status}; its log is {log}")
        finally:
            watchdog.cancel()
            process.kill()
            process.wait()
        return rows

    def _text(self, name: str) -> str:
        file = self._folder / name
        return file.read_text(encoding="utf-8") if file.exists() else ""

    def _wait(self, condition: Callable[[], bool], patience_s: float, what: str) -> None:
        deadline = time.monotonic() + patience_s
        while not condition():
            failed = self._failed_agent()
            if failed is not None:
                raise StageFailed(f"{failed.name} ended: {failed.last_words()}")
            if self.sim.process.poll() is not None:
                raise StageFailed(f"the simulator ended: {self.sim.last_words()}")
            if time.monotonic() > deadline:
                raise StageFailed(f"waited {patience_s:g} s for {what}")
            time.sleep(0.05)
