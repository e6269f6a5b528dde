"""The scripted operator: a process with an operator's view, which is what the page shows.

It hears tracked poses and joints, never truth, and commands the tool like a joystick would. What
it does is in `sim.plan`, how well it does it in `sim.hand`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from threading import Event
from typing import TypeVar

from scene.builder import SceneBuilder
from scene.database import Database
from scene.graph import ObjectNode, SceneState
from scene.robot import Robot
from scene.site import Site
from sim.hand import Grip, Hand, HandModel
from sim.plan import PLANS, Phase, goal
from sim.rig import TOOL_COMMAND
from spatial.errors import InputError, MessageError, unknown
from spatial.frames import Base, Tcp
from spatial.pose import Pose
from spatial.samples import ToolCommand
from spatial.stamp import NS_PER_MS, Clock, seconds
from spatial.tracked import TrackState
from wire.bus import Bus, Sample
from wire.codec import decode_joints, decode_tracked, encode
from wire.keys import Keys

log = logging.getLogger(__name__)

PERIOD_NS = 20 * NS_PER_MS
"""Commands are sent at 50 Hz [ns]."""
TTL_NS = 300 * NS_PER_MS
"""Time to live of a command [ns]."""
_CAPACITY = 16

T = TypeVar("T")


class Operator:
    """Looks at the scene and commands the tool; `tick` it from a thread or in lock-step."""

    def __init__(
        self,
        bus: Bus,
        *,
        keys: Keys,
        clock: Clock,
        site: Site,
        robot: Robot,
        database: Database,
        plan: str = "pick",
        seed: int = 0,
        model: HandModel | None = None,
    ) -> None:
        """Sit down.

        Args:
            bus: what it hears tracked poses and joints from and speaks commands to.
            keys: names on the bus.
            clock: the site's clock, as a station knows it.
            site: the site as the station knows it.
            robot: its robot.
            database: its objects.
            plan: one of `sim.plan.PLANS`.
            seed: of the tremor.
            model: how good it is.

        Raises:
            InputError: an unknown plan.
        """
        if plan not in PLANS:
            raise InputError(unknown("plan", plan, PLANS))
        self._bus = bus
        self._key = keys.command(TOOL_COMMAND)
        self._clock = clock
        self._plan = PLANS[plan]
        self._site = site
        self._builder = SceneBuilder(site, robot, database)
        self._frames = database.entry(site.target).frames
        self._tracked = bus.subscribe(keys.tracked, capacity=_CAPACITY)
        self._joints = bus.subscribe(keys.joints, capacity=_CAPACITY)
        self._seed = seed
        self._model = model or HandModel()
        self._hand: Hand | None = None
        self._start: Pose[Base, Tcp] = Pose.identity()
        self._grip: str | None = None
        self._T_base_grip: Pose[Base, Grip] = Pose.identity()
        self._start_ns = 0
        self._last_ns = 0
        self._sequence = 0
        self.phase = ""
        self.refused = 0

    def tick(self, now_ns: int) -> None:
        """Look, and command when it is time, at `now_ns` of the site's clock."""
        if now_ns - self._last_ns < PERIOD_NS:
            return
        for joints in self._heard(self._joints.take()[-1:], decode_joints):
            self._builder.put_joints(joints)
        for tracked in self._heard(self._tracked.take()[-1:], decode_tracked):
            self._builder.put_tracked(tracked)
        scene = self._builder.build(now_ns)
        if scene.robot_ms is None:
            return
        if self._hand is None:
            self._sit_down(scene, now_ns)
        self._command(scene, now_ns)
        self._last_ns = now_ns

    def serve(self, stop: Event) -> None:
        """Operate until told to stop."""
        while not stop.is_set():
            self.tick(self._clock.now_ns())
            stop.wait(seconds(PERIOD_NS) / 2)

    def _sit_down(self, scene: SceneState, now_ns: int) -> None:
        self._start = scene.T_base_tcp
        self._start_ns = self._last_ns = now_ns
        self._hand = Hand(self._model, start=Pose(self._start.matrix), seed=self._seed)
        self._grip = None
        self._T_base_grip = Pose.identity()

    def _command(self, scene: SceneState, now_ns: int) -> None:
        time_s = seconds(now_ns - self._start_ns)
        phase = self._plan.at(time_s)
        if phase.name != self.phase:
            log.debug("operator: %s", phase.name)
            self.phase = phase.name
        target = self._shown_target(scene)
        wanted = goal(
            phase,
            time_s=time_s,
            T_base_tcp_start=self._start,
            Ts_base_frame={} if target is None else self._shown_frames(target),
        )
        hand = self._hold(phase, target)
        T_grip_tcp = hand.step(
            self._T_base_grip.inverse() @ wanted,
            now_s=time_s,
            dt_s=seconds(now_ns - self._last_ns),
        )
        self._sequence += 1
        command = ToolCommand(now_ns, self._sequence, TTL_NS, self._T_base_grip @ T_grip_tcp)
        message = encode(command)
        self._bus.publish(self._key, message.payload, schema=message.schema)

    def _hold(self, phase: Phase, target: ObjectNode | None) -> Hand:
        """Hold on to the target where the phase is about it and it is shown, else to the base."""
        assert self._hand is not None
        grip, T_base_grip = None, Pose[Base, Grip].identity()
        if phase.frame is not None and target is not None and target.T_base_object is not None:
            grip, T_base_grip = target.slug, Pose(target.T_base_object.matrix)
        if grip != self._grip:
            self._hand.regrip(T_base_grip.inverse() @ self._T_base_grip)
            self._grip = grip
        self._T_base_grip = T_base_grip
        return self._hand

    def _shown_target(self, scene: SceneState) -> ObjectNode | None:
        """Return the target as the page shows it, `None` where it is LOST or was never seen."""
        for node in scene.objects:
            if node.slug == self._site.target and node.state is not TrackState.LOST:
                return node
        return None

    def _shown_frames(self, target: ObjectNode) -> dict[str, Pose[Base, Tcp]]:
        """Return the target's named frames as the page would show them."""
        if target.T_base_object is None:
            return {}
        return {
            name: Pose((target.T_base_object @ frame.T_object_frame).matrix)
            for name, frame in self._frames.items()
        }

    def _heard(self, samples: list[Sample], decode: Callable[[bytes], T]) -> list[T]:
        """Decode what can be; the rest is counted and dropped."""
        heard = []
        for sample in samples:
            try:
                heard.append(decode(sample.payload))
            except MessageError:
                self.refused += 1
                log.debug("message refused", exc_info=True)
        return heard


def run_operator(
    bus: Bus,
    *,
    keys: Keys,
    clock: Clock,
    site: Site,
    robot: Robot,
    database: Database,
    stop: Event,
    plan: str = "pick",
    seed: int = 0,
) -> None:
    """Operate until `stop` is set: the body of the operator's process."""
    Operator(
        bus,
        keys=keys,
        clock=clock,
        site=site,
        robot=robot,
        database=database,
        plan=plan,
        seed=seed,
    ).serve(stop)
