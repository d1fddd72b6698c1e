"""Walking through a house: moves, turns and looks, collisions and noise."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import ClassVar

import jax
import jax.numpy as jnp

from envs_jax.houses import collision, geodesic, manipulation, pictures
from envs_jax.houses.noise import Noise
from envs_jax.houses.scene import Scene, forward
from envs_jax.houses.state import Body, HouseState
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import POMDP, Environment, PyTree
from jaxact.spaces import Discrete

ACTIONS: tuple[str, ...] = (
    "move_ahead",
    "move_back",
    "rotate_left",
    "rotate_right",
    "look_up",
    "look_down",
)
ACTIONS += ("open", "close", "pick_up", "put_down", "end")
COLLISIONS = ("fail", "stop", "slide")
# A body that slides meets no more than this many things in one move.
_CONTACTS = 3


@dataclass(frozen=True)
class House(Environment):
    """The dynamics of a body in a house.

    Attributes:
      body: what walks.
      actions: names out of `ACTIONS`, in the order of their numbers. "open", "close" and "pick_up"
        act on the nearest thing in front that allows it, "put_down" on what is in front; "end" does
        nothing: tasks know what it means.
      step_size: metres of a move.
      turn: degrees.
      look: degrees of a look up or down.
      look_limits: least and greatest pitch, degrees down; a look beyond them is refused.
      collision: what becomes of a move into something: "fail", the body stays where it is
        (AI2-THOR); "stop", it stops there; "slide", it goes on alongside (Habitat).
      noise: what moves and turns err by; None for nothing.
      reach: metres from the body's axis at which things are acted on.
    """

    numbers_are_structure: ClassVar[bool] = True

    body: Body
    actions: tuple[str, ...]
    step_size: float = 0.25
    turn: float = 30.0
    look: float = 30.0
    look_limits: tuple[float, float] = (-30.0, 60.0)
    collision: str = "fail"
    noise: Noise | None = None
    reach: float = 1.25

    def __post_init__(self) -> None:
        for name in self.actions:
            if name not in ACTIONS:
                raise unknown("action of a house", name, ACTIONS)
        if len(set(self.actions)) < len(self.actions):
            raise JaxactError(f"a house's actions are each named once, not {self.actions}")
        if self.collision not in COLLISIONS:
            raise unknown("collision", self.collision, COLLISIONS)

    @property
    def action_names(self) -> tuple[str, ...]:
        """The names of `actions`."""
        return self.actions

    @property
    def action_space(self) -> Discrete:
        """One number for each of `actions`."""
        return Discrete(len(self.actions))

    def start(
        self,
        scene: Scene,
        position: jax.Array,
        yaw: jax.Array | float = 0.0,
        pitch: jax.Array | float = 0.0,
    ) -> HouseState:
        """Returns the state of an agent that has just been put into a scene.

        Args:
          scene: the house.
          position: float32 [2], a plan.
          yaw: degrees.
          pitch: degrees down.
        """
        return HouseState(
            scene=scene,
            position=jnp.asarray(position, jnp.float32),
            yaw=jnp.asarray(yaw, jnp.float32),
            pitch=jnp.asarray(pitch, jnp.float32),
            collided=jnp.bool_(False),
            last_action=jnp.int32(len(self.actions)),
            held=jnp.int32(-1),
        )

    def step(self, key: jax.Array, state: HouseState, action: jax.Array) -> HouseState:
        """Returns the state after one action; `key` is for the noise."""
        action = jnp.asarray(action, jnp.int32)
        step = self._amount(action, move_ahead=self.step_size, move_back=-self.step_size)
        angle = self._amount(action, rotate_right=self.turn, rotate_left=-self.turn)
        error = jnp.zeros(3, jnp.float32)
        if self.noise is not None:
            error = self.noise.sample(key, step, angle)
        ahead = forward(state.yaw)
        right = jnp.stack([ahead[1], -ahead[0]])
        move = (step + error[0]) * ahead + error[1] * right
        boxes = collision.obstacles(state.scene.boxes, self.body)
        position, collided = self.move(boxes, state.position, move)
        yaw = jnp.mod(state.yaw + angle + error[2], 360)
        pitch = state.pitch + self._amount(action, look_down=self.look, look_up=-self.look)
        low, high = self.look_limits
        allowed = (pitch >= low - 1e-3) & (pitch <= high + 1e-3)
        state = replace(
            state,
            position=position,
            # What is a rounding short of 0 is 360 after it.
            yaw=jnp.where(yaw >= 360, 0, yaw),
            pitch=jnp.where(allowed, pitch, state.pitch),
            collided=collided,
            last_action=action,
        )
        for name, act in manipulation.ACTS.items():
            if name in self.actions:
                acted = act(state, self.body, self.reach)
                chosen = action == self.actions.index(name)
                state = jax.tree.map(
                    lambda new, old, c=chosen: jnp.where(c, new, old), acted, state
                )
        return state

    def move(
        self, obstacles: jax.Array, position: jax.Array, move: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Moves the body as far as it gets.

        Args:
          obstacles: float32 [N, 8], see `collision.obstacles`.
          position: float32 [2], a plan.
          move: float32 [2].

        Returns:
          Where it is then, and a bool scalar, whether it met something.
        """
        radius = self.body.radius
        share, row = collision.sweep(obstacles, radius, position, move)
        met = share < 1
        if self.collision == "fail":
            return jnp.where(met, position, position + move), met
        for contact in range(_CONTACTS):
            if contact:
                share, row = collision.sweep(obstacles, radius, position, move)
            length = jnp.sqrt(jnp.sum(move**2))
            room = jnp.maximum(share - collision.SKIN / jnp.maximum(length, 1e-9), 0)
            room = jnp.where(share < 1, room, 1)
            position, move = position + room * move, (1 - room) * move
            if self.collision == "stop":
                break
            _, way = collision.clearance(obstacles[row][None], position)
            move -= jnp.sum(move * way[0]) * way[0]
        return position, met

    def _amount(self, action: jax.Array, **amounts: float) -> jax.Array:
        """Returns the float32 amount that belongs to an action, 0 for those not named."""
        table = [amounts.get(name, 0.0) for name in self.actions]
        return jnp.asarray(table, jnp.float32)[action]

    def waypoint(self, state: HouseState) -> jax.Array:
        """Returns the agent's plan, float32 [2]."""
        return state.position

    def chart(self, state: HouseState, task_state: PyTree, trail: jax.Array) -> jax.Array:
        """Returns the house from above, with the trail in blue, uint8 [256, 256, 3].

        If the task's state has a `journey`, the shortest way from the trail's beginning is shown in
        orange, with the goal that it leads to.
        """
        journey, way, goal = getattr(task_state, "journey", None), None, None
        if journey is not None:
            boxes = collision.obstacles(state.scene.boxes, self.body)
            way = geodesic.path(journey.field, boxes, self.body.radius, trail[0])
            goal = way[-1]
        return pictures.house_map(
            state.scene, state, self.body, goal=goal, trajectory=trail, path=way
        )


def check_house(owner: str, house: House, pomdp: POMDP) -> None:
    """Refuses a part that was made for another body or other moves than the environment has.

    Args:
      owner: what the part is called.
      house: what the part was made for.
      pomdp: that it is to be a part of.

    Raises:
      JaxactError: they differ; the message says in what.
    """
    environment = pomdp.environment
    if not isinstance(environment, House) or environment == house:
        return
    for field in fields(House):
        here, there = (getattr(each, field.name) for each in (house, environment))
        if here != there:
            raise JaxactError(
                f"{owner}.{field.name} is {here!r}, but environment.{field.name} is {there!r}: "
                "a house's dynamics are set alike in environment, task.house and sampler.task.house"
            )
