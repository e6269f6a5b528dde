"""The site without a clock, a thread or a bus: plant, guard and sensors, stepped as one.

Live drives it at wall pace (`sim.site`), lock-step as fast as it goes (`sim.lockstep`); both get
the same bytes for the same seed and the same commands.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

from scene.database import Database
from scene.robot import Robot
from scene.site import Site
from sim.outlet import Outlet
from sim.plant import Plant
from sim.scenario import Scenario
from sim.sensors import STEPS_PER_S, Sensors, is_due
from sim.truth import true_cameras, true_markers
from sim.vio import level_named
from sim.world import World, load_world
from spatial.errors import MessageError
from spatial.frames import Base, Tcp, W
from spatial.pose import Pose
from spatial.stamp import NS_PER_S
from teleop.safety import TAKEN, GuardState, SafetyLimits, accept, advance, initial_state
from wire.codec import Encoded, decode_command
from wire.keys import Keys

STEP_NS = NS_PER_S // STEPS_PER_S
"""Length of a physics step [ns]."""
GUARD_EVERY = 4
"""Physics steps between two moves of the guarded set-point."""
TOOL_COMMAND = "tool"
"""Name of the command that moves the tool."""


@dataclass(frozen=True, slots=True, eq=False)
class Staging:
    """Everything a simulated session is made of."""

    site: Site
    """Nominal description."""
    robot: Robot
    """Its robot."""
    database: Database
    """Its objects, nominal."""
    scenario: Scenario
    """What the session is like."""
    seed: int
    """Seeds every random number."""
    keys: Keys
    """Names on the bus."""


def build_plant(staging: Staging) -> Plant:
    """Return the plant of a session, with true values drawn around the nominal ones."""
    site, scenario = staging.site, staging.scenario
    world = _staged(load_world(scenario.world), scenario)
    entries = (staging.database.entry(place.slug) for place in world.placements)
    marked = [entry.marked() for entry in entries if entry.markers]
    return Plant(
        site,
        staging.robot,
        staging.database,
        world=world,
        cameras=true_cameras(site, scenario=scenario, seed=staging.seed),
        markers=true_markers(marked, scenario=scenario, seed=staging.seed),
        seed=staging.seed,
    )


def _staged(world: World, scenario: Scenario) -> World:
    """Return the world as a scenario wants it."""
    sway = world.sway
    if scenario.slow_sway_m is not None:
        sway = replace(sway, slow_m=scenario.slow_sway_m)
    if scenario.fast_sway_m is not None:
        sway = replace(sway, fast_m=scenario.fast_sway_m)
    return replace(
        world,
        sway=sway,
        shades=world.shades if scenario.shade else (),
        placements=tuple(
            replace(place, free=place.free and scenario.loose) for place in world.placements
        ),
    )


class Rig:
    """Plant, guard and sensors of one site."""

    def __init__(
        self, plant: Plant, *, staging: Staging, outlet: Outlet, rates_hz: Mapping[str, float]
    ) -> None:
        """Start at rest.

        Args:
            plant: the physics.
            staging: what the session is made of.
            outlet: where measurements leave.
            rates_hz: frame rate by camera.
        """
        self.plant = plant
        self._sensors = Sensors(
            plant,
            site=staging.site,
            robot=staging.robot,
            keys=staging.keys,
            vio=level_named(staging.scenario.vio),
            seed=staging.seed,
            outlet=outlet,
        )
        self._rates_hz = dict(rates_hz)
        self._limits = SafetyLimits()
        self._guard = initial_state(_tool_in_base(plant))
        self._steps = 0
        self.verdicts: Counter[str] = Counter()

    @property
    def steps(self) -> int:
        """Physics steps done."""
        return self._steps

    @property
    def guard(self) -> GuardState:
        """What the guard of commands lets the tool do now."""
        return self._guard

    def latched(self, stamp_ns: int) -> dict[str, Encoded]:
        """Return what a late joiner must know, by key."""
        return self._sensors.latched(stamp_ns)

    def hear(self, payload: bytes, *, now_ns: int) -> None:
        """Weigh a tool command; what cannot be decoded is counted like what is refused."""
        try:
            command = decode_command(payload)
        except MessageError:
            self.verdicts["garbage"] += 1
            return
        self._guard, verdict = accept(
            self._limits, state=self._guard, command=command, now_ns=now_ns
        )
        self.verdicts[verdict.value] += 1

    @property
    def refused(self) -> int:
        """Commands that did not move the goal."""
        taken = {verdict.value for verdict in TAKEN}
        return sum(count for verdict, count in self.verdicts.items() if verdict not in taken)

    def step(self, *, stamp_ns: int) -> tuple[str, ...]:
        """Advance to `stamp_ns` [ns], one millisecond on; return the cameras that expose then."""
        if self._steps % GUARD_EVERY == 0 and not self._guard.holding:
            dt_s = GUARD_EVERY / STEPS_PER_S
            self._guard = advance(self._limits, state=self._guard, now_ns=stamp_ns, dt_s=dt_s)
            self.plant.command_tool(self._guard.T_base_tcp)
        self.plant.step()
        self._steps += 1
        self._sensors.tick(self._steps, stamp_ns=stamp_ns)
        return tuple(
            name for name, rate_hz in self._rates_hz.items() if is_due(self._steps, rate_hz=rate_hz)
        )


def _tool_in_base(plant: Plant) -> Pose[Base, Tcp]:
    truth = plant.truth()
    T_w_base: Pose[W, Base] = Pose(truth["base"].matrix)
    T_w_tcp: Pose[W, Tcp] = Pose(truth["tcp"].matrix)
    return T_w_base.inverse() @ T_w_tcp
