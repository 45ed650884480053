"""Throws messages at all keys of a run that goes on, just before each state goes out, and counts what it threw.

Everything happens on the thread that carries the simulator's states, so what is open at whose key is known.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Sequence

from msgspec import structs

from deploy.chaos.fuzz.aims import Aim, Moment
from deploy.chaos.fuzz.spoiling import PERHAPS, SURELY, changed
from sim_server.faults.spoiled import timeless
from wire.codec import decode, decode_any, encode
from wire.errors import Reason
from wire.keys import ANY_HELLO, Keys
from wire.link import Question
from wire.memory import Broker, MemoryPublisher, MemoryQuestion, key_matches
from wire.messages import Command, Goodbye, Hello, LeaderForce, LeaderView, Leaving, Order, Refusal, State

FIRST_TICK = 2
"""By then all leases are known, and every agent answers on the thread that tells it."""
LEADER = "leader"
WAYS = (*SURELY, *PERHAPS, "misplaced")
WEIGHTS = (*(1 for _ in SURELY), *(4 for _ in PERHAPS), 8)

Told = Callable[[int], None]


class Fuzzer:
    """One run's.

    Args:
        broker: on which the run is carried; the simulator is there, the agents are not yet.
        keys: of the run.
        arms: their names.
        leader_every: the leader is asked every so many ticks.
        seed: of all that is drawn.
        messages: how many are sent.
        at_once: before each state.
        told: is told how many have been sent.
    """

    def __init__(
        self,
        broker: Broker,
        keys: Keys,
        arms: Sequence[str],
        leader_every: int,
        seed: int,
        messages: int,
        at_once: int,
        told: Told,
    ) -> None:
        self._broker, self._draws, self._left, self._told = broker, random.Random(seed), messages, told
        self._at_once, self._messages, self._leader_every = at_once, messages, leader_every
        self._now, self._link = Moment(), broker.link()
        self.sent: Counter[str] = Counter()
        """By what is wrong with them."""
        self.sent_to: Counter[str] = Counter()
        """By receiver."""
        self.left_out: Counter[str] = Counter()
        """By how they were made: those that were whole by chance, and were not sent."""
        self.not_refused = 0
        """Greetings that were answered with anything but a refusal, or not."""
        self._questions: list[MemoryQuestion] = []
        self._throws = False
        self._aims: list[Aim] = []
        self._by_key: dict[str, Aim] = {}
        for name in (*arms, LEADER):
            theirs = keys.leader if name == LEADER else keys.arm(name)
            self._add(Aim("told", name, theirs.state))
            self._add(Aim("answer", name, theirs.command))
            self._add(Aim("greeting", name, theirs.hello))
            self._link.subscribe(theirs.state, self._watcher(name))
            self._link.subscribe(theirs.command, self._listener(name))
        self._add(Aim("order", "", keys.order, [encode(Order("stop", 0)), encode(Order("join", 1))]))
        strangers = (keys.arm("a99").hello, Keys("other").arm("a1").hello, Keys("other").leader.hello)
        for key in strangers:
            self._add(Aim("greeting", "", key))
        for expression in ANY_HELLO:
            self._link.answer_queries(expression, self._on_greeting)
        self._pools = {key: aim.real for key, aim in self._by_key.items()}

    def _add(self, aim: Aim) -> None:
        self._aims.append(aim)
        self._by_key[aim.key] = aim

    def _on_greeting(self, question: Question) -> None:
        """A real one; what it says of its process is not drawn from a seed, so it is left out."""
        if self._throws:
            return
        message = decode_any(question.payload)
        if not isinstance(message, Hello):
            return
        hello = encode(structs.replace(message, pid=1, host="here"))
        mine = self._by_key[question.key]
        mine.real[:] = [hello, encode(Leaving(mine.name, 1)), encode(Goodbye(mine.name, 1))]
        for aim in self._aims:
            if aim.sort == "greeting" and not aim.name:
                aim.real[:] = [hello]

    def _watcher(self, name: str) -> Callable[[bytes], None]:
        """What it does when a state or a view goes out, before the agent has it."""
        aim = next(each for each in self._aims if (each.sort, each.name) == ("told", name))
        kind = LeaderView if name == LEADER else State

        def take(payload: bytes) -> None:
            if self._throws:
                return
            message = decode_any(payload)
            if not isinstance(message, kind):
                return
            now = self._now
            if message.tick > now.tick:
                now.tick = message.tick
                now.answered = {LEADER} if message.tick % self._leader_every else set()
            if now.tick >= FIRST_TICK:
                self._throw()
            aim.real[:] = [payload]
            now.got[name] = message.tick

        return take

    def _listener(self, name: str) -> Callable[[bytes], None]:
        """What it does when an agent has answered, after the simulator has it."""
        aim = next(each for each in self._aims if (each.sort, each.name) == ("answer", name))

        def take(payload: bytes) -> None:
            if self._throws:
                return
            message = decode(payload, LeaderForce) if name == LEADER else decode(payload, Command)
            aim.real[:] = [timeless(payload)]
            self._now.answered.add(name)
            self._now.leases[name] = message.lease

        return take

    def _throw(self) -> None:
        self._throws = True
        for _ in range(min(self._at_once, self._left)):
            while not self._throw_one():
                pass
            self._left -= 1
        self._throws = False
        self._count_replies()
        self._told(self._messages - self._left)

    def _throw_one(self) -> bool:
        """Draw a message and send it; whether one was sent."""
        draws = self._draws
        aim = draws.choice(self._aims)
        (way,) = draws.choices(WAYS, WEIGHTS)
        if way == "misplaced":
            found = aim.misplaced(draws, self._now, self._pools)
            if found is None:
                return False
            way, payload = found
        else:
            spoil = SURELY.get(way) or PERHAPS[way]
            spoiled = spoil(self._whole_one(aim), draws)
            if spoiled is None:
                return False
            if way in PERHAPS and aim.is_whole(spoiled, self._now):
                self.left_out[way] += 1
                return False
            payload = spoiled
        self.sent[way] += 1
        self.sent_to[aim.receiver] += 1
        if aim.sort == "greeting":
            self._ask(aim.key, payload)
        else:
            MemoryPublisher(self._link, self._broker, aim.key).put(payload)
        return True

    def _whole_one(self, aim: Aim) -> bytes:
        """A real message of this key to be spoiled, of the tick that is awaited there: nothing else is wrong."""
        payload = self._draws.choice(aim.real)
        if aim.sort == "answer":
            return changed(payload, tick=self._now.tick)
        return changed(payload, tick=self._now.got[aim.name] + 1) if aim.sort == "told" else payload

    def _ask(self, key: str, payload: bytes) -> None:
        """A query whose answer comes when the simulator looks into its inbox, as over a real transport."""
        question = MemoryQuestion(key, payload)
        self._questions.append(question)
        for _, expression, handler in tuple(self._broker.queryables):
            if key_matches(expression, key):
                handler(question)

    def _count_replies(self) -> None:
        """Those asked before the present tick have been answered by now."""
        while len(self._questions) > 1000:
            self._check(self._questions.pop(0))

    def finish(self) -> None:
        """The run is over: look at the answers that are left."""
        while self._questions:
            self._check(self._questions.pop())

    def _check(self, question: MemoryQuestion) -> None:
        replies = [decode_any(reply) for reply in question.replies]
        refused = len(replies) == 1 and isinstance(replies[0], Refusal) and replies[0].reason in set(Reason)
        self.not_refused += not refused

    @property
    def left(self) -> int:
        """How many were not sent before the run's end."""
        return self._left
