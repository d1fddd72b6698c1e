"""Navigation by name: platforms, tasks and what is sensed are exchanged by a word each."""

import dataclasses

import jax
import numpy as np
import pytest

import envs_jax
from envs_jax.houses import navigation
from envs_jax.houses.catalogue import OBSERVATIONS, PLATFORMS
from jaxact.errors import JaxactError
from jaxact.overrides import numbers

TITLES = {platform.title for platform in PLATFORMS.values()}
IDS = [name for name in envs_jax.ids() if name.split("-")[0] in TITLES]


def test_every_platform_has_both_tasks():
    assert [
        f"{platform}-{task}-v0"
        for platform in ("Habitat", "RoboTHOR", "iTHOR")
        for task in ("ObjectNav", "PointNav")
    ] == IDS


@pytest.mark.parametrize("name", IDS)
def test_what_is_asked_for_is_sensed(name):
    wanted = tuple(x for x in OBSERVATIONS if x != "goal_mask" or "ObjectNav" in name)
    pomdp = envs_jax.make(name, observation=wanted, resolution=16)
    goal = "point_goal" if "PointNav" in name else "object_goal"
    spaces = pomdp.observation_space.spaces
    assert set(spaces) == {goal, *wanted}
    assert spaces["rgb"].shape == (16, 16, 3)
    blind = envs_jax.make(name, observation=())
    assert set(blind.observation_space.spaces) == {goal}
    assert pomdp.environment.action_names.count("end") == 1
    # Who is evaluated is in other houses.
    assert pomdp.sampler.held_out.scenes != pomdp.sampler.scenes


def test_noise_is_the_only_difference_of_noisy_worlds():
    still, noisy = (envs_jax.make("RoboTHOR-PointNav-v0", noisy=x) for x in (False, True))
    assert still.environment.noise is None
    quiet = dataclasses.replace(noisy.environment, noise=None)
    assert quiet == still.environment
    assert noisy.task.house == noisy.environment


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"platform": "robotor"}, "robothor"),
        ({"task": "pointnav"}, "point_nav"),
        ({"style": "flat"}, "apartment"),
        ({"observation": ("dept",)}, "depth"),
        ({"observation": ("goal_mask",)}, "point_goal"),
        ({"resolution": 0}, "resolution must be at least 1"),
        ({"houses": 0}, "at least one"),
    ],
)
def test_bad_input_is_one_sentence(options, message):
    with pytest.raises(JaxactError, match=message):
        navigation(**options)


# SPL counts against straight ways. Who walks on a lattice goes round them: by search over all walks
# the best there is has 0.907 on average over 63 episodes.
LEAST = {"iTHOR-ObjectNav-v0": 0.88}


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_experts_succeed_in_houses_held_out(name):
    pomdp = envs_jax.make(name, observation=(), houses=4)
    sampler = dataclasses.replace(
        pomdp.sampler, scenes=dataclasses.replace(pomdp.sampler.scenes, split="val", count=16)
    )
    lanes = 64
    bank = jax.jit(sampler.init)(jax.random.key(0))
    sample = jax.jit(jax.vmap(sampler.sample, (0, None)))
    state = jax.vmap(pomdp.begin)(sample(jax.random.split(jax.random.key(1), lanes), bank))

    @jax.jit
    def follow(keys, state):
        advice = jax.vmap(pomdp.expert)(keys, state)
        return jax.vmap(pomdp.step)(keys, state, advice.action)

    done, success, spl = np.zeros(lanes, bool), np.zeros(lanes, bool), np.zeros(lanes)
    for i in range(500):
        state, step = follow(jax.random.split(jax.random.key(i), lanes), state)
        new = np.asarray(step.finished) & ~done
        success |= new & np.asarray(step.success)
        spl = np.where(new, step.metrics["spl"], spl)
        done |= new
        if done.all():
            break
    assert success.all()
    assert spl.mean() >= LEAST.get(name, 0.97)


@pytest.mark.parametrize("name", IDS)
def test_tasks_numbers_are_data_and_geometry_is_not(name):
    pomdp = envs_jax.make(name)
    found = numbers(pomdp)
    assert {"task.shaping", "task.success_reward", "task.step_penalty"} <= found.keys()
    assert not [path for path in found if path.startswith(("environment.", "sensors."))]
