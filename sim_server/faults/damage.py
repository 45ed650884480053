"""All physical faults of one world: who is hit, what the model's numbers are meanwhile, what has been seen.

Numbers of the model are set back to what was compiled, and changed anew by every fault that goes on, whenever one
begins or ends, the world is exchanged, or a run goes on from a checkpoint. So faults add up, and none leaves anything.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim_server.faults import added_mass, joints, sensors, wheels
from sim_server.faults.event import Seen
from sim_server.faults.physical import PhysicalEffect, PhysicalEvent
from sim_server.layout import Array
from sim_server.scene import set_constants
from sim_server.snapshot import Snapshot
from sim_server.world import World

EFFECTS: Mapping[type[PhysicalEvent], type[PhysicalEffect]] = {
    **joints.EFFECTS,
    **wheels.EFFECTS,
    **sensors.EFFECTS,
    **added_mass.EFFECTS,
}
SETTINGS = {
    fault.kind: fault.settings for fault in (*joints.FAULTS, *wheels.FAULTS, *sensors.FAULTS, *added_mass.FAULTS)
}
SHAPED = (
    "dof_frictionloss",
    "dof_solref",
    "dof_solimp",
    "body_pos",
    "body_mass",
    "body_ipos",
    "body_inertia",
    "body_iquat",
)
"""Numbers of the model that faults change."""


class Damage:
    """The physical faults of one world.

    Args:
        world: where they act.
        substeps: physics steps of a tick.
        dt_s: of a physics step.
    """

    def __init__(self, world: World, substeps: int, dt_s: float) -> None:
        self._substeps, self._dt_s = substeps, dt_s
        self._effects: list[PhysicalEffect] = []
        self._begun = 0
        self.news: list[Seen] = []
        """What has been seen of the faults; whoever reports it takes it out."""
        self._bind(world)

    def _bind(self, world: World) -> None:
        self._world = world
        self._row = {name: row for row, name in enumerate(world.arms)}
        self._compiled = {name: getattr(world.model, name).copy() for name in SHAPED}

    @property
    def goes_on(self) -> bool:
        """Whether there is any."""
        return bool(self._effects)

    def begin(self, event: PhysicalEvent, tick: int, end: int | None) -> None:
        """A fault goes on from this tick to, and without, the tick ``end``."""
        effect = self._effect(event, self._begun, tick, end)
        self._effects.append(effect)
        self._begun += 1
        self._shape(tick * self._substeps, inertia=effect.changes_inertia)

    def _effect(self, event: PhysicalEvent, number: int, begin: int, end: int | None) -> PhysicalEffect:
        return EFFECTS[type(event)](event, self._world.scenario.seed, number, begin, end)

    def _elapsed_s(self, effect: PhysicalEffect, step: int) -> float:
        return (step - effect.begin * self._substeps) * self._dt_s

    def _shape(self, step: int, *, inertia: bool) -> None:
        model = self._world.model
        for name, numbers in self._compiled.items():
            getattr(model, name)[:] = numbers
        for each in sorted(self._effects, key=lambda each: each.moves):
            if each.moves and inertia:
                set_constants(model)  # before anything has moved: else they would depend on when it is done
                inertia = False
            if each.shapes:
                each.shape(self._world, self._elapsed_s(each, step))
        if inertia:
            set_constants(model)

    def advance(self, step: int) -> None:
        """Before a physics step (counted from the run's start): what moves has moved on."""
        if any(each.moves for each in self._effects):
            self._shape(step, inertia=False)

    def sense(self, readings: Array, tick: int) -> None:
        """What all sensors say in this tick, (N, 3n + 6), is changed in place."""
        for each in self._effects:
            if each.event.arm is not None:
                each.sense(readings[self._row[each.event.arm]], tick)

    def deliver(self, torque: Array, base_force: Array) -> tuple[Array, Array]:
        """What all drives give, of what they mean to: (N, n) N m and (N, 3) N, N, N m, the caller's own."""
        torque, base_force = torque.copy(), base_force.copy()
        for each in self._effects:
            if each.event.arm is not None:
                row = self._row[each.event.arm]
                each.drive(torque[row], base_force[row])
        return torque, base_force

    def settle(self, tick: int) -> None:
        """After the physics, when ``tick`` comes next: what has been seen, and what is over."""
        over = []
        for each in self._effects:
            each.watch(self._world, tick)
            if not each.told and each.seen:
                each.told = True
                self.news.append(Seen(each.event, each.seen))
            if each.is_over(tick, self._elapsed_s(each, tick * self._substeps)):
                over.append(each)
                self.news.append(_last(each, "it has ended"))
        self._remove(over, tick)

    def _remove(self, over: list[PhysicalEffect], tick: int) -> None:
        if over:
            self._effects = [each for each in self._effects if each not in over]
            self._shape(tick * self._substeps, inertia=any(each.changes_inertia for each in over))

    def finish(self) -> None:
        """The run is over: tell what the faults that went on have done."""
        self.news += [_last(each, "until the run's end") for each in self._effects]
        self._effects.clear()

    def move_to(self, world: World, tick: int) -> None:
        """The world has other robots now: faults go on, unless their robot has been taken away."""
        self._bind(world)
        gone = [each for each in self._effects if each.event.arm is not None and each.event.arm not in self._row]
        self.news += [_last(each, "its robot has been taken away") for each in gone]
        self._effects = [each for each in self._effects if each not in gone]
        if self._effects:
            self._shape(tick * self._substeps, inertia=any(each.changes_inertia for each in self._effects))

    def state(self) -> Snapshot:
        """The faults that go on, and what nobody has reported yet."""
        return {
            "effects": [
                [each.event.model_dump(mode="json"), each.number, each.begin, each.end, each.told, each.state()]
                for each in self._effects
            ],
            "begun": self._begun,
            "news": [[each.event.model_dump(mode="json"), each.effect, each.proves] for each in self.news],
        }

    def restore(self, saved: Snapshot, tick: int) -> None:
        """Go on from there, in a world without any."""
        for event, number, begin, end, told, state in saved["effects"]:
            effect = self._effect(_event(event), int(number), int(begin), None if end is None else int(end))
            effect.told = bool(told)
            effect.restore(state)
            self._effects.append(effect)
        self._begun = int(saved["begun"])
        self.news[:] = [Seen(_event(event), str(text), bool(proves)) for event, text, proves in saved["news"]]
        self._shape(tick * self._substeps, inertia=any(each.changes_inertia for each in self._effects))


def _last(effect: PhysicalEffect, when: str) -> Seen:
    return Seen(effect.event, f"{when}: {effect.count or 'nothing was seen of it'}", proves=effect.told)


def _event(saved: Mapping[str, object]) -> PhysicalEvent:
    """The settings of a physical fault as :meth:`Damage.state` has them."""
    event = SETTINGS[str(saved["kind"])].model_validate(saved)
    assert isinstance(event, PhysicalEvent)
    return event
