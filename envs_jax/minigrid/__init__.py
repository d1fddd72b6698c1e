"""MiniGrid and BabyAI in pure JAX: same ids, dynamics, observations, missions and rewards."""

from envs_jax.minigrid import interop as interop
from envs_jax.minigrid.advisor import register_all as _register_advisor
from envs_jax.minigrid.catalogue import register_all as _register_all
from envs_jax.minigrid.missions import decode_mission as decode_mission
from envs_jax.minigrid.missions import encode_mission as encode_mission

__all__ = ["decode_mission", "encode_mission", "interop"]

_register_all()
_register_advisor()
