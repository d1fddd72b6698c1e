"""Any MJCF model as an environment, stepped by MJX.

All that a step needs of the one before is carried: joints, activations, the solver's warm start and
mocap bodies. The rest of MJX's `Data` is made anew in each step, which gives the same bits as
carrying it, so that a lane is small.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.physics.capsules import capsules_as_in_c
from envs_jax.physics.models import device_model, host_model, mjx
from jaxact.errors import JaxactError, check_at_least, unknown
from jaxact.pomdp import POMDP, Environment, PyTree
from jaxact.spaces import Box, Space

# What of MuJoCo's data can be kept in the state besides, see `Physics.extras`.
EXTRAS = ("cinert", "cvel", "qfrc_actuator", "cfrc_ext", "subtree_com")
# What MuJoCo takes for a simulation that has come apart (mjMAXVAL).
_TOO_LARGE = 1e10


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Variation:
    """By what an episode's model differs from the one that was read: factors, 1 for no difference.

    Attributes:
      mass: float32 [nbody], of the bodies' masses and moments of inertia.
      friction: float32 [ngeom], of the geoms' coefficients of friction.
      gain: float32 [nu], of what the actuators answer to their controls and to motion.
    """

    mass: jax.Array
    friction: jax.Array
    gain: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PhysicsState:
    """How a simulation stands; units are the model's, metres, radians and seconds as a rule.

    Poses, forces and readings are those of MuJoCo's last evaluation in the step, as in C: with the
    Euler integrator, at the beginning of the last substep.

    Attributes:
      position: float32 [nq], of the joints (`qpos`).
      velocity: float32 [nv], of the joints (`qvel`).
      activation: float32 [na], of actuators that have one.
      warm_start: float32 [nv], where the solver begins.
      time: float32 scalar.
      mocap_position: float32 [nmocap, 3].
      mocap_rotation: float32 [nmocap, 4], quaternions w, x, y, z.
      body_position: float32 [nbody, 3], in the world.
      body_rotation: float32 [nbody, 4], quaternions.
      site_position: float32 [nsite, 3].
      constraint_force: float32 [nv], of contacts and limits on the joints.
      readings: float32 [nsensordata], of the sensors that the model has.
      diverged: bool scalar: the last step led to numbers that are none, or beyond all bounds, and
        was not taken.
      variation: of the episode's model; None for the model as it was read.
      extras: float32 each, what the world keeps besides, by MuJoCo's names.
    """

    position: jax.Array
    velocity: jax.Array
    activation: jax.Array
    warm_start: jax.Array
    time: jax.Array
    mocap_position: jax.Array
    mocap_rotation: jax.Array
    body_position: jax.Array
    body_rotation: jax.Array
    site_position: jax.Array
    constraint_force: jax.Array
    readings: jax.Array
    diverged: jax.Array
    variation: Variation | None = None
    extras: dict[str, jax.Array] = field(default_factory=dict)


class Controller(ABC):
    """What turns actions into controls, anew in each substep of the simulation."""

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of discrete actions; by default there are none."""
        return ()

    @property
    @abstractmethod
    def action_space(self) -> Space:
        """The actions it takes."""

    @abstractmethod
    def controls(
        self,
        world: Physics,
        action: PyTree,
        before: PhysicsState,
        position: jax.Array,
        velocity: jax.Array,
    ) -> jax.Array:
        """Returns the controls float32 [nu] of one substep.

        Args:
          world: whose actuators they are for.
          action: that the step was taken with.
          before: how the simulation stood when the step began.
          position: float32 [nq], of the joints now.
          velocity: float32 [nv], likewise.
        """


@dataclass(frozen=True)
class Physics(Environment):
    """A MuJoCo model. It is deterministic; actions are controls of its actuators, or what a
    controller makes controls of.

    If all actuators have one range, actions are their controls. If not, actions lie in [−1, 1], and
    each is stretched to its actuator's range. Beyond the bounds they are clipped.

    Attributes:
      source: a path of an MJCF file, or its text. Paths are read once in a process; runs know a
        model by its path, so what is in the file must stay the same.
      substeps: of the simulation in a step.
      controller: what takes the actions; None for the actuators themselves.
      extras: what of MuJoCo's data states have besides, of `EXTRAS`: "cinert" [nbody, 10], inertia
        of bodies about their tree's centre of mass; "cvel" [nbody, 6], their velocities there;
        "qfrc_actuator" [nv], the actuators' forces on the joints; "cfrc_ext" [nbody, 6], torque and
        force from outside on bodies, 0 where an episode begins, but for models with sensors that
        read it; "subtree_com" [nbody, 3], centres of mass of bodies with all that hangs on them.

    Raises:
      JaxactError: the model cannot be read or simulated, has no actuators or one without a range.
    """

    source: str = field(repr=False)
    substeps: int = 1
    controller: Controller | None = None
    extras: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.source, os.PathLike):
            object.__setattr__(self, "source", os.fspath(self.source))
        if not isinstance(self.source, str):
            raise JaxactError(
                f"a physics world needs an MJCF file's path, or its text, not {self.source!r}"
            )
        check_at_least(1, "a physics world", substeps=self.substeps)
        if not isinstance(self.controller, Controller | None):
            raise JaxactError(
                "the controller of a physics world is an object of a class of "
                f"envs_jax.physics.Controller, not {self.controller!r}"
            )
        for name in self.extras:
            if name not in EXTRAS:
                raise unknown("quantity of MuJoCo's data", name, EXTRAS)
        device_model(self.source)
        model = self.model
        if not model.opt.timestep > 0:
            raise JaxactError(
                f"the model's timestep is {model.opt.timestep}, and has to be above 0"
            )
        if not model.nu:
            raise JaxactError("the model has no actuators, so there is nothing to act with")
        for index in np.flatnonzero(~model.actuator_ctrllimited.astype(bool)):
            raise JaxactError(
                f"actuator {model.actuator(int(index)).name!r} (number {index}) has no ctrlrange, "
                "or is not limited to it: give it one, since actions are bounded"
            )

    @property
    def model(self) -> Any:
        """The `mujoco.MjModel`."""
        return host_model(self.source)

    @property
    def dt(self) -> float:
        """Seconds of a step."""
        return float(self.model.opt.timestep) * self.substeps

    @property
    def action_names(self) -> tuple[str, ...]:
        """The controller's, if it has any."""
        return self.controller.action_names if self.controller else ()

    @property
    def action_space(self) -> Space:
        """The controller's actions; controls, or numbers in [−1, 1] to be stretched to them."""
        if self.controller:
            return self.controller.action_space
        low, high = self._bounds
        return Box(low, high, (self.model.nu,))

    def index(self, kind: str, name: str) -> int:
        """Returns the number of a named part.

        Args:
          kind: "body", "joint", "geom", "site", "camera", "sensor" or "actuator".
          name: in the model.

        Raises:
          JaxactError: there is no such kind or name; the message has the nearest.
        """
        model = self.model
        counts = {
            "actuator": model.nu,
            "body": model.nbody,
            "camera": model.ncam,
            "geom": model.ngeom,
            "joint": model.njnt,
            "sensor": model.nsensor,
            "site": model.nsite,
        }
        if kind not in counts:
            raise unknown("kind of a model's parts", kind, counts)
        names = [getattr(model, kind)(i).name for i in range(counts[kind])]
        if name not in names:
            raise unknown(f"{kind} of the model", name, [n for n in names if n])
        return names.index(name)

    def start(
        self,
        position: jax.Array,
        velocity: jax.Array,
        *,
        mocap_position: jax.Array | None = None,
        mocap_rotation: jax.Array | None = None,
        variation: Variation | None = None,
    ) -> PhysicsState:
        """Returns the state in which a simulation begins, at rest but for what is said.

        Args:
          position: float32 [nq], of the joints.
          velocity: float32 [nv].
          mocap_position: float32 [nmocap, 3]; where the model has them, if None.
          mocap_rotation: float32 [nmocap, 4], quaternions; likewise.
          variation: by what the model differs in this episode.

        Raises:
          JaxactError: there are more or fewer numbers than joints have.
        """
        _check_shape("position", position, self.model.nq)
        _check_shape("velocity", velocity, self.model.nv)
        model = self._on_device(variation)
        with jax.numpy_dtype_promotion("standard"):
            data = mjx().make_data(model).replace(qpos=position, qvel=velocity)
            if mocap_position is not None:
                data = data.replace(mocap_pos=mocap_position)
            if mocap_rotation is not None:
                data = data.replace(mocap_quat=mocap_rotation)
            # Readings need forces. Where there are none, poses are enough.
            if self.model.nsensor:
                with capsules_as_in_c():
                    data = mjx().forward(model, data)
                data = data.replace(qacc_warmstart=jnp.zeros_like(data.qacc_warmstart))
            else:
                data = mjx().kinematics(model, data)
                if self.extras:
                    data = mjx().com_vel(model, mjx().com_pos(model, data))
        return self._state(data, jnp.bool_(False), variation)

    def step(self, key: jax.Array, state: PhysicsState, action: PyTree) -> PhysicsState:
        """Simulates `substeps` steps with one action; `key` is not used."""
        del key
        model = self._on_device(state.variation)

        def advance(_: Any, data: Any) -> Any:
            if self.controller:
                data = data.replace(
                    ctrl=self.controller.controls(self, action, state, data.qpos, data.qvel)
                )
            return mjx().step(model, data)

        with jax.numpy_dtype_promotion("standard"), capsules_as_in_c():
            data = mjx().make_data(model)
            data = data.replace(
                qpos=state.position,
                qvel=state.velocity,
                act=state.activation,
                qacc_warmstart=state.warm_start,
                time=state.time,
                mocap_pos=state.mocap_position,
                mocap_quat=state.mocap_rotation,
            )
            if not self.controller:
                data = data.replace(ctrl=self.controls(action))
            if self.substeps > 1:
                data = jax.lax.fori_loop(0, self.substeps, advance, data)
            else:
                data = advance(0, data)
            if "cfrc_ext" in self.extras:
                data = mjx().rne_postconstraint(model, data)
        moving = jnp.concatenate([data.qpos, data.qvel, data.act])
        # Numbers that are none are not below the bound.
        is_sound = jnp.all(jnp.abs(moving) < _TOO_LARGE)
        after = self._state(data, ~is_sound, state.variation)
        kept = jax.tree.map(lambda new, old: jnp.where(is_sound, new, old), after, state)
        return replace(kept, diverged=~is_sound)

    def controls(self, action: jax.Array) -> jax.Array:
        """Returns the controls, float32 [nu], that an action of the actuators' own stands for.

        Raises:
          JaxactError: it is not one number for each.
        """
        _check_shape("action", action, self.model.nu)
        low, high = self._bounds
        action = jnp.clip(jnp.asarray(action, jnp.float32), jnp.float32(low), jnp.float32(high))
        if low == self.model.actuator_ctrlrange[0, 0]:
            return action
        return self.stretched(action)

    def stretched(self, shares: jax.Array) -> jax.Array:
        """Returns controls float32 [nu] for numbers in [−1, 1], each of its actuator's range."""
        lows, highs = jnp.asarray(self.model.actuator_ctrlrange.T, jnp.float32)
        return lows + (shares + 1.0) * (highs - lows) / 2

    def _on_device(self, variation: Variation | None) -> Any:
        model = jax.tree.map(jnp.asarray, device_model(self.source))
        if variation is None:
            return model
        gains = variation.gain[:, None]
        return model.replace(
            body_mass=model.body_mass * variation.mass,
            body_inertia=model.body_inertia * variation.mass[:, None],
            body_subtreemass=_subtree_sum(self.model, model.body_mass * variation.mass),
            geom_friction=model.geom_friction * variation.friction[:, None],
            actuator_gainprm=model.actuator_gainprm * gains,
            actuator_biasprm=model.actuator_biasprm * gains,
        )

    def _state(self, data: Any, diverged: jax.Array, variation: Variation | None) -> PhysicsState:
        def floats(x: Any) -> jax.Array:
            return jnp.asarray(x, jnp.float32)

        def find(name: str) -> jax.Array:
            return getattr(data._impl if hasattr(data._impl, name) else data, name)

        return PhysicsState(
            position=floats(data.qpos),
            velocity=floats(data.qvel),
            activation=floats(data.act),
            warm_start=floats(data.qacc_warmstart),
            time=floats(data.time),
            mocap_position=floats(data.mocap_pos),
            mocap_rotation=floats(data.mocap_quat),
            body_position=floats(data.xpos),
            body_rotation=floats(data.xquat),
            site_position=floats(data.site_xpos),
            constraint_force=floats(data.qfrc_constraint),
            readings=floats(data.sensordata),
            diverged=diverged,
            variation=variation,
            extras={name: floats(find(name)) for name in self.extras},
        )

    @property
    def _bounds(self) -> tuple[float, float]:
        ranges = self.model.actuator_ctrlrange
        if np.all(ranges == ranges[0]):
            return float(ranges[0, 0]), float(ranges[0, 1])
        return -1.0, 1.0


def check_model(pomdp: POMDP, world: Physics, name: str) -> None:
    """Refuses an environment of another model than a part of the POMDP has.

    Args:
      pomdp: whose environment it is.
      world: the part's.
      name: what the part calls it, such as "task.world".

    Raises:
      JaxactError: the models differ.
    """
    environment = pomdp.environment
    if not isinstance(environment, Physics) or environment.source != world.source:
        raise JaxactError(
            f"{name} is of another model than the environment, in which what it names may be "
            "elsewhere: give both the same"
        )


def _check_shape(what: str, given: jax.Array, count: int) -> None:
    if jnp.shape(given) != (count,):
        raise JaxactError(
            f"the {what} in this model has the shape {(count,)}, not {jnp.shape(given)}"
        )


def _subtree_sum(model: Any, values: jax.Array) -> jax.Array:
    """Returns the sum of a number [nbody] over each body and all that hang on it."""
    hangs = np.zeros((model.nbody, model.nbody), np.float32)
    for body in range(model.nbody):
        parent = body
        while True:
            hangs[parent, body] = 1
            if parent == 0:
                break
            parent = int(model.body_parentid[parent])
    return jnp.asarray(hangs) @ values
