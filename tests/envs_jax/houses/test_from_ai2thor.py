"""AI2-THOR behind the bridge, with a stand-in for its controller."""

import builtins
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs_jax.houses import metrics, presets
from envs_jax.houses.catalogue import navigation
from envs_jax.houses.from_ai2thor import ThorNavigation, from_ai2thor
from envs_jax.houses.importers.episodes import NavigationEpisode
from jaxact import JaxactError
from jaxact.evaluation import begin_held_out
from jaxact.simulators import explained
from tests.envs_jax.houses.thor_standin import HEIGHT, SCENES, SIDE, StandIn

SIZE = {"width": 8, "height": 6}


@pytest.fixture(autouse=True)
def nothing_started():
    StandIn.started.clear()


def world(task="point_nav", platform="robothor", **options):
    options = {"make_controller": StandIn, **SIZE, **options}
    return from_ai2thor(platform, task, **options)


def to_point(start, yaw, goal, scene=SCENES[0]):
    place = (start[0], HEIGHT, start[1])
    return NavigationEpisode("a", scene, place, yaw, goals=((goal[0], HEIGHT, goal[1]),))


def to_mug(start, yaw):
    return NavigationEpisode("b", SCENES[0], (start[0], HEIGHT, start[1]), yaw, 0.0, "Mug")


def walk(pomdp, *names):
    """Returns what each action gives from the first state of the world's one episode."""
    step, key = jax.jit(pomdp.step), jax.random.key(0)
    state, observation = jax.jit(pomdp.reset)(key)
    steps = []
    for name in names:
        state, after = step(key, state, jnp.int32(pomdp.environment.action_names.index(name)))
        steps.append(jax.device_get(after))
    return jax.device_get(observation), steps


def test_a_walk_to_a_point_is_judged_as_in_houses():
    pomdp = world(episodes=[to_point((1, 1), 90, (1.5, 1))], observation=("depth", "rgb"))
    first, steps = walk(pomdp, "move_ahead", "rotate_left", "rotate_right", "move_ahead", "end")
    # Paths begin 0.05 m aside, which counts twice: to there, and a little on the way.
    far = [0.05 + math.hypot(x, 0.05) for x in (0.5, 0.25, 0.25, 0.25, 0.0, 0.0)]
    terms = [step.reward_terms for step in steps]
    shaping = [a - b for a, b in itertools.pairwise(far)]
    np.testing.assert_allclose([t["shaping"] for t in terms], shaping, atol=1e-6)
    np.testing.assert_allclose([t["step"] for t in terms], -0.01)
    assert [float(t["success"]) for t in terms] == [0, 0, 0, 0, 10]
    assert [bool(s.terminated) for s in steps] == [False] * 4 + [True]
    assert [bool(s.success) for s in steps] == [False] * 4 + [True]
    np.testing.assert_allclose(first["point_goal"], [0.5, 0], atol=1e-5)
    np.testing.assert_allclose(steps[1].observation["point_goal"], [0.25, -np.pi / 6], atol=1e-5)
    np.testing.assert_allclose(first["depth"], (2.0 - 0.5) / 0.25)
    assert first["depth"].shape == (6, 8, 1)
    assert [int(s.observation["rgb"][0, 0, 0]) for s in steps[:3]] == [90, 60, 90]
    last = {name: float(x) for name, x in steps[-1].metrics.items()}
    assert last["path_length"] == 0.5
    np.testing.assert_allclose(last["distance_to_goal"], 0.1, atol=1e-6)
    spl = metrics.spl(jnp.bool_(True), jnp.float32(far[0]), jnp.float32(0.5))
    np.testing.assert_allclose(last["spl"], spl)
    np.testing.assert_allclose(
        last["soft_spl"], (1 - 0.1 / far[0]) * far[0] / max(far[0], 0.5), rtol=1e-5
    )


def test_ending_far_away_fails_and_walls_stop():
    pomdp = world(episodes=[to_point((1, SIDE), 0, (1, 1))])
    _, steps = walk(pomdp, "move_ahead", "end", "move_ahead")
    assert float(steps[0].metrics["path_length"]) == 0
    assert float(steps[0].reward_terms["shaping"]) == 0
    assert steps[1].terminated
    assert not steps[1].success
    assert float(steps[1].metrics["spl"]) == 0
    assert "MoveAhead" in StandIn.started[0].calls
    assert StandIn.started[0].calls.count("MoveAhead") == 1


def test_objects_are_found_where_they_are_visible():
    """By the simulator's word, with iTHOR's penalty for what fails."""
    options = {"platform": "ithor", "targets": ("Vase", "Mug"), "observation": ()}
    pomdp = world("object_nav", episodes=[to_mug((2.5, 1.25), 0)], **options)
    names = ("look_up", "look_up", "end")
    first, steps = walk(pomdp, *names)
    assert int(first["object_goal"]) == 1
    np.testing.assert_allclose([s.reward_terms["refusal"] for s in steps], [0, -0.03, 0])
    assert float(steps[-1].reward_terms["success"]) == 1
    assert steps[-1].success
    away = world("object_nav", episodes=[to_mug((2.5, 1.25), 90)], **options)
    _, (step,) = walk(away, "end")
    assert float(step.reward_terms["success"]) == -1
    assert not step.success


@pytest.mark.slow
@pytest.mark.parametrize("task", ["point_nav", "object_nav"])
def test_names_are_those_of_houses(task):
    ours = navigation("robothor", task, resolution=6, houses=1)
    theirs = world(task, scenes=SCENES[:1], targets=("Mug",))
    assert theirs.environment.action_names == ours.environment.action_names
    assert set(theirs.observation_space.spaces) == set(ours.observation_space.spaces)

    def step_of(pomdp):
        state, _ = jax.eval_shape(pomdp.reset, jax.random.key(0))
        return jax.eval_shape(pomdp.step, jax.random.key(0), state, jnp.int32(0))[1]

    step, other = step_of(ours), step_of(theirs)
    assert set(other.reward_terms) == set(step.reward_terms)
    assert set(other.metrics) == set(step.metrics)


def test_drawn_episodes_are_their_seeds():
    pomdp = world(scenes=SCENES[:1], simulators=2)
    keys = jnp.stack([jax.random.key(0), jax.random.key(1)])
    state, _ = jax.jit(jax.vmap(pomdp.reset))(keys)
    place = np.asarray(state.environment.observation["place"])
    assert (place[0] != place[1]).any()
    pomdp.environment.close()
    assert all(controller.stopped for controller in StandIn.started)
    again, _ = jax.jit(jax.vmap(pomdp.reset))(keys)
    np.testing.assert_array_equal(again.environment.observation["place"], place)
    np.testing.assert_array_equal(np.remainder(place[:, 2], 30), 0)
    np.testing.assert_array_equal(np.remainder(place[:, :2], 0.25), 0)


def test_held_out_episodes_are_each_played():
    held_out = [to_point((1, 1), 30.0 * i, (2, 2), SCENES[1]) for i in range(3)]
    pomdp = world(scenes=SCENES[:1], held_out_episodes=held_out)
    yaws = []
    for i in range(3):
        state, _ = begin_held_out(pomdp, jnp.int32(i))
        yaws.append(float(state.environment.observation["place"][2]))
        pomdp.environment.close()
    assert yaws == [0, 30, 60]
    assert pomdp.sampler.held_out.count == 3
    assert {call for one in StandIn.started[1:] for call in one.calls if "reset" in call} == {
        f"reset {SCENES[1]}"
    }


def test_the_controller_is_set_as_the_platform_is():
    world(scenes=SCENES[:1], quality="Low")
    settings = StandIn.started[0].settings
    assert settings["agentMode"] == "locobot"
    assert (settings["gridSize"], settings["rotateStepDegrees"]) == (0.25, 30.0)
    assert settings["visibilityDistance"] == 1.0
    assert settings["renderDepthImage"]
    assert settings["quality"] == "Low"
    # RoboTHOR's camera sees 79 degrees across, and 63.453 down at 4 : 3.
    assert settings["fieldOfView"] == pytest.approx(63.453, abs=1e-2)


def test_bad_input_is_answered_in_a_sentence(monkeypatch):
    with pytest.raises(JaxactError, match="platform 'robotor'; the nearest is 'robothor'"):
        world(platform="robotor")
    with pytest.raises(JaxactError, match="task 'pointnav'; the nearest is 'point_nav'"):
        world("pointnav")
    with pytest.raises(JaxactError, match="view of AI2-THOR 'rbg'; the nearest is 'rgb'"):
        world(scenes=SCENES[:1], observation=("rbg",))
    with pytest.raises(JaxactError, match=r"scenes is a sequence of names, as \('FloorPlan1',\)"):
        world(scenes="FloorPlan1")
    with pytest.raises(JaxactError, match="either episodes or the names of scenes"):
        world()
    with pytest.raises(JaxactError, match="episode 'b' must have a point to go to"):
        world(episodes=[to_mug((1, 1), 0)])
    with pytest.raises(JaxactError, match="target of episode 'b' 'Mug'; the nearest is 'Bowl'"):
        world("object_nav", episodes=[to_mug((1, 1), 0)], targets=("Bowl",))
    with pytest.raises(JaxactError, match="rule of success is 'visible', not 'view_point'"):
        ThorNavigation(presets.object_nav("habitat"))
    for episode, message in (
        (to_point((9, 9), 0, (1, 1)), "cannot begin at .* target position is not in a room"),
        (to_point((1, 1), 0, (9, 9)), "episode 'a' has no way to its goal"),
        (to_point((1, 1), 0, (2, 2), "FloorPlan0"), "could not load 'FloorPlan0': FloorPlan0 is"),
    ):
        with pytest.raises(JaxactError, match=message), explained():
            jax.block_until_ready(world(episodes=[episode]).reset(jax.random.key(0)))

    original = builtins.__import__

    def without(name, *arguments, **options):
        if name.startswith("ai2thor"):
            raise ImportError(name)
        return original(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(JaxactError, match="which is not installed: pip install ai2thor"):
        world(scenes=SCENES[:1], make_controller=None)
