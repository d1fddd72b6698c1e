"""Training in houses on two devices: it compiles in reasonable time and learns from every lane."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import envs_jax

ROOT = Path(__file__).parents[3]
PLATFORMS = {"iTHOR", "RoboTHOR", "Habitat"}
IDS = [name for name in envs_jax.ids() if name.split("-")[0] in PLATFORMS]
SCRIPT = """
import sys
import envs_jax, jax, jaxact
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, Concatenated, Embedding, Vector

pomdp = envs_jax.make(sys.argv[1], observation=(), houses=4)
goal = {"point_goal": Vector((8,)), "object_goal": Embedding(8, 16)}
encoder = Concatenated({name: goal[name] for name in pomdp.sensors})
pipeline = jaxact.TrainingPipeline(
    (jaxact.Stage({"ppo": PPO()}, steps=256),), lanes=8, rollout_length=16
)
experiment = jaxact.Experiment(
    "devices", pomdp, ActorCritic(pomdp.action_space, encoder, GRU(8)), pipeline
)
result = jaxact.train(experiment, evaluate_every=0, evaluation_episodes=2, progress=False)
print(jax.device_count(), len(result.evaluation.success))
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_two_devices_start_within_three_minutes(name):
    """What draws episodes took LLVM four minutes once, on two devices only."""
    environment = {**os.environ, "JAX_NUM_CPU_DEVICES": "2", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", SCRIPT, name]
    run = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=180, check=False
    )
    assert run.returncode == 0, run.stderr[-2000:]
    assert run.stdout.split() == ["2", "2"]
