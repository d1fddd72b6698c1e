"""Environments of Gymnasium as worlds: the same as stepped by hand, and errors in one sentence."""

import dataclasses
import functools
import os
import re
import subprocess
import sys
import textwrap

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import JaxactError, Stage, TrainingPipeline, train
from jaxact.checkpoints import Checkpoints
from jaxact.collect import collect
from jaxact.distributions import Categorical
from jaxact.evaluation import evaluate_policy
from jaxact.experiment import Experiment
from jaxact.from_gymnasium import from_gymnasium
from jaxact.gymnasium_adapter import to_gymnasium, to_gymnasium_vector
from jaxact.gymnax_adapter import to_gymnax
from jaxact.losses import PPO
from jaxact.models import ActorCritic, Concatenated, NoMemory
from jaxact.models.output import ActorCriticOutput
from jaxact.program import Program, choose_devices
from jaxact.rollout import rollout, start_lanes
from jaxact.search_space import log_uniform
from jaxact.simulated import SimulatedState, SimulatedTask
from jaxact.simulators import explained
from jaxact.sweep import sweep
from tests.simulated import LENGTH, Countdown, countdown
from tests.tiny import Plain

LANES, STEPS = 4, 40


@pytest.fixture(autouse=True)
def nothing_reset_yet():
    Countdown.resets.clear()


def play(pomdp, lanes, steps, action):
    """Plays the lanes' first episodes, however they end; returns their seeds and all steps."""
    step = jax.jit(jax.vmap(pomdp.step))
    keys = jax.random.split(jax.random.key(0), lanes)
    state, observation = jax.jit(jax.vmap(pomdp.reset))(keys)
    seeds, found = np.asarray(state.environment.seed), []
    for t in range(steps):
        state, after = step(keys, state, action[t])
        found.append(after)
    return seeds, observation, jax.tree.map(lambda *x: np.stack(x), *found)


def by_hand(name, seed, actions):
    """Returns what Gymnasium itself says, up to the end of the episode."""
    env = gymnasium.make(name)
    first, _ = env.reset(seed=int(seed))
    steps = []
    for action in actions:
        steps.append(env.step(action)[:4])
        if steps[-1][2] or steps[-1][3]:
            break
    env.close()
    return first, [np.stack(x) for x in zip(*steps, strict=True)]


@pytest.mark.parametrize("name", ["CartPole-v1", "Pendulum-v1", "Hopper-v5"])
def test_what_happens_is_what_happens_in_gymnasium(name):
    """Beyond the end an episode stays as it is and earns nothing."""
    if name == "Hopper-v5":
        pytest.importorskip("mujoco")
    pomdp = from_gymnasium(name, simulators=LANES)
    keys = jax.random.split(jax.random.key(1), STEPS * LANES)
    action = jax.vmap(pomdp.action_space.sample)(keys)
    action = np.asarray(action).reshape(STEPS, LANES, *action.shape[1:])
    seeds, first, steps = play(pomdp, LANES, STEPS, action)
    assert len(set(seeds.tolist())) == LANES
    ended = 0
    for lane, seed in enumerate(seeds):
        start, (seen, reward, terminated, truncated) = by_hand(name, seed, action[:, lane])
        np.testing.assert_array_equal(first["observation"][lane], start.astype(np.float32))
        length = len(seen)
        ours = jax.tree.map(lambda x, lane=lane: x[:, lane], steps)
        np.testing.assert_array_equal(ours.observation["observation"][:length], np.float32(seen))
        np.testing.assert_array_equal(ours.reward[:length], np.float32(reward))
        np.testing.assert_array_equal(ours.terminated[:length], terminated)
        np.testing.assert_array_equal(ours.truncated[:length], truncated)
        assert (ours.reward[length:] == 0).all()
        assert (ours.observation["observation"][length:] == np.float32(seen[-1])).all()
        ended += length < STEPS
    assert (ended == 0) == (name == "Pendulum-v1")


def test_actions_are_clipped_to_their_bounds():
    pomdp = from_gymnasium("Pendulum-v1", simulators=1)
    seeds, _, steps = play(pomdp, 1, 3, np.full((3, 1, 1), 7.0, np.float32))
    _, (seen, *_) = by_hand("Pendulum-v1", seeds[0], np.full((3, 1), 2.0, np.float32))
    np.testing.assert_array_equal(steps.observation["observation"][:, 0], np.float32(seen))


class Memoryless:
    """Waits or counts at random, without a memory."""

    @staticmethod
    def initial_memory(lanes):
        return jnp.zeros(lanes, jnp.int32)


def policy(observation, memory, previous_action, is_first):
    del previous_action, is_first
    value = observation["left"][..., 0]
    return ActorCriticOutput(Categorical(jnp.zeros((*value.shape, 2))), value), memory


def test_rollouts_reset_each_simulator_once_for_each_episode():
    """Nothing is reset ahead or in vain, and each lane plays its episodes from their beginning."""
    pomdp = countdown(LANES, threads=2)
    keys = jax.random.split(jax.random.key(0), LANES)
    lanes = start_lanes(pomdp, (), Memoryless, keys, queue_length=1)
    run = jax.jit(lambda lanes: rollout(pomdp, policy, (), lanes, STEPS))
    for _ in range(2):
        lanes, trajectory = run(lanes)
    jax.block_until_ready(lanes)
    total = sum(int(x) for x in lanes.queue.served)
    assert len(Countdown.resets) == len(set(Countdown.resets)) == total > 4 * LANES
    finished = np.asarray(trajectory.step.finished)
    left = np.asarray(trajectory.observation["left"])[..., 0]
    digit = np.asarray(trajectory.observation["digit"])
    after = np.asarray(trajectory.step.observation["left"])[..., 0]
    np.testing.assert_array_equal(after, left - np.asarray(trajectory.action))
    begun = {(1 + seed % LENGTH, seed % 10) for seed in Countdown.resets}
    for t, lane in zip(*np.nonzero(finished[:-1]), strict=True):
        assert (left[t + 1, lane], digit[t + 1, lane]) in begun
    going_on = ~finished[:-1]
    np.testing.assert_array_equal(left[1:][going_on], after[:-1][going_on])
    np.testing.assert_array_equal(trajectory.step.terminated, after == 0)
    late = np.asarray(trajectory.finished.length) == 6
    np.testing.assert_array_equal(trajectory.step.truncated, late)
    assert (finished == (late | (after == 0))).all()
    assert late.any()


def test_endings_successes_and_metrics():
    pomdp = countdown(patience=4, horizon=3)
    action = np.stack([np.ones((6, LANES)), np.zeros((6, LANES))]).astype(np.int32)
    seeds, _, steps = play(pomdp, LANES, 6, action[0])
    length = np.minimum(1 + seeds % LENGTH, 3)
    last = length - 1, np.arange(LANES)
    np.testing.assert_array_equal(steps.metrics["taken"][last], length)
    np.testing.assert_array_equal(steps.success[last], seeds % LENGTH < 3)
    np.testing.assert_array_equal(steps.terminated[last], seeds % LENGTH < 3)
    np.testing.assert_array_equal(steps.truncated[2], True)
    _, _, waited = play(pomdp, LANES, 6, action[1])
    np.testing.assert_array_equal(waited.truncated.all(1), [False, False, True, True, True, True])
    np.testing.assert_array_equal(waited.truncated.any(1), [False, False, True, True, True, True])
    assert not (waited.terminated | waited.success).any()


@pytest.mark.parametrize(
    ("said", "total", "success"), [(-1, 4, False), (-1, 5, True), (0, 9, False), (1, 0, True)]
)
def test_success_is_what_is_said_or_enough_of_a_return(said, total, success):
    number = jnp.float32
    state = SimulatedState(
        ticket=jnp.zeros(6, jnp.uint32),
        observation={},
        reward=number(1),
        episode_return=number(total),
        terminated=jnp.bool_(True),
        truncated=jnp.bool_(False),
        success=number(said),
        metrics={},
    )
    _, outcome = SimulatedTask(success_return=5.0).step((), state, (), state)
    assert bool(outcome.success["goal"]) == success
    assert from_gymnasium("CartPole-v1").task == SimulatedTask(475.0)


def experiment(pomdp, **settings):
    model = ActorCritic(pomdp.action_space, Concatenated({"left": Plain()}), NoMemory())
    stage = Stage({"ppo": PPO()}, steps=256)
    settings = {"lanes": 8, "rollout_length": 8, "minibatches": 2, "epochs": 1} | settings
    return Experiment("countdown", pomdp, model, TrainingPipeline((stage,), **settings))


OPTIONS = {
    "evaluate_every": 128,
    "evaluation_episodes": 11,
    "checkpoint_every": 128,
    "progress": False,
}


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    small = experiment(countdown())
    return small, train(small, seed=1, output=tmp_path_factory.mktemp("runs"), **OPTIONS)


def test_training_is_reproducible_and_evaluation_apart(trained):
    """Evaluations in between use other simulators and change nothing."""
    small, result = trained
    again = train(small, seed=1, **{**OPTIONS, "evaluate_every": 0})
    for name, values in result.metrics.items():
        np.testing.assert_array_equal(again.metrics[name], values, err_msg=name)
    one, other = result.evaluation, again.evaluation
    np.testing.assert_array_equal(one.length, other.length)
    assert len(one.length) == 11
    assert one.metrics["task/taken"].tolist() == one.length.tolist()
    assert one.metrics["reward/reward"].tolist() == one.episode_return.tolist()


def test_resumed_training_begins_new_episodes(trained, tmp_path, monkeypatch):
    """A checkpoint does not hold the simulators: every lane goes on with its next episode.

    Though before the run was resumed in vain, by simulators that came apart.
    """
    small, result = trained
    small.pomdp.environment.close()
    for path in (result.run / "checkpoints").iterdir():
        if int(path.name) == 256:
            path.rename(tmp_path / path.name)
    like = Program(small, choose_devices(1)).like()
    restored = Checkpoints(result.run / "checkpoints").restore(None, like).state
    assert not restored.lanes.is_first.all()
    saved = sorted(path.name for path in (result.run / "checkpoints").iterdir())
    monkeypatch.setattr(Countdown, "comes_apart_at", 3)
    with pytest.raises(
        JaxactError, match=r"^simulator \d of Countdown failed .*'left' .* \(NaN\)$"
    ):
        train(small, seed=1, resume=result.run, **{**OPTIONS, "evaluation_episodes": 0})
    monkeypatch.undo()
    assert sorted(path.name for path in (result.run / "checkpoints").iterdir()) == saved
    small.pomdp.environment.close()
    Countdown.resets.clear()
    resumed = train(small, seed=1, resume=result.run, **{**OPTIONS, "evaluation_episodes": 0})
    assert resumed.metrics["step"].tolist() == [192, 256]
    begun = resumed.state.lanes.queue.served - restored.lanes.queue.served
    assert (begun >= 1).all()
    assert len(Countdown.resets) == begun.sum()


@pytest.mark.slow
def test_devices_share_the_simulators():
    script = """
        import numpy as np
        from jaxact import train
        from tests.jaxact.test_from_gymnasium import OPTIONS, experiment
        from tests.simulated import countdown

        small = experiment(countdown())
        one, two = (train(small, seed=1, devices=n, **OPTIONS) for n in (1, 2))
        for name, values in one.metrics.items():
            np.testing.assert_allclose(values, two.metrics[name], rtol=2e-3, atol=2e-4)
        np.testing.assert_array_equal(one.metrics["train/length"], two.metrics["train/length"])
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    subprocess.run(command, check=True, env={**os.environ, "JAX_NUM_CPU_DEVICES": "2"})


def test_listed_seeds_are_evaluated_in_order(trained):
    """In environments of their own."""
    pomdp = countdown(4, held_out=functools.partial(Countdown, 2), held_out_seeds=6)
    played = evaluate_policy(pomdp, trained[1].policy, 100)
    assert sorted(Countdown.resets) == list(range(6))
    assert len(played.length) == 6
    assert played.length.max() == 2
    assert (played.length[played.success] >= 1 + np.arange(6)[played.success] % LENGTH).all()


def test_recordings_are_of_simulated_episodes(trained, tmp_path):
    small, result = trained
    recorded = collect(
        small.pomdp, tmp_path / "recorded", 20, world="countdown", policy=result.policy,
        final_observations=True, progress=False,
    )  # fmt: skip
    assert recorded.episodes == 20


def test_states_that_are_not_the_latest_are_refused():
    pomdp = countdown()
    step = jax.jit(pomdp.step)
    key = jax.random.key(0)
    state, _ = jax.jit(pomdp.reset)(key)
    step(key, state, jnp.int32(0))
    with (
        pytest.raises(JaxactError, match=r"at step 0 of the episode .* its simulator is at step 1"),
        explained(),
    ):
        jax.block_until_ready(step(key, state, jnp.int32(0)))
    pomdp.environment.close()
    with (
        pytest.raises(JaxactError, match="no simulator is playing its episode any more"),
        explained(),
    ):
        jax.block_until_ready(step(key, state, jnp.int32(0)))


def test_actions_of_other_shapes_are_refused():
    pomdp = countdown()
    state, _ = jax.eval_shape(pomdp.reset, jax.random.key(0))
    message = r"an action of Countdown has the shape \(\), not \(2,\)"
    with pytest.raises(JaxactError, match=message):
        jax.eval_shape(pomdp.step, jax.random.key(0), state, jnp.zeros(2, jnp.int32))


def test_lanes_that_share_an_episode_are_refused():
    pomdp = countdown()
    keys = jnp.stack([jax.random.key(0)] * 2)
    state, _ = jax.vmap(pomdp.reset)(keys)
    with pytest.raises(JaxactError, match="another lane is playing the same episode"), explained():
        jax.block_until_ready(jax.vmap(pomdp.step)(keys, state, jnp.zeros(2, jnp.int32)))


def test_gymnasiums_code_is_told_what_failed(monkeypatch):
    """Where the bridge is crossed both ways."""
    pomdp = countdown(2)
    with pytest.raises(JaxactError, match="num_envs is 3, but the world can be simulated 2 times"):
        to_gymnasium_vector(pomdp, 3)
    monkeypatch.setattr(Countdown, "fails_at", 1)
    env = to_gymnasium(pomdp)
    env.reset(seed=0)
    with pytest.raises(JaxactError, match=r"^simulator \d of Countdown failed at step 0 "):
        env.step(0)


def test_more_episodes_than_simulators_are_refused():
    keys = jax.random.split(jax.random.key(0), 3)
    with (
        pytest.raises(JaxactError, match="than there are simulators, 2: have no more lanes"),
        explained(),
    ):
        jax.block_until_ready(jax.vmap(countdown(2).reset)(keys))
    with pytest.raises(JaxactError, match="8 lanes, but the world can be simulated 2 times at"):
        experiment(countdown(2)).check()


def test_a_simulator_that_fails_says_so_in_one_sentence(trained, monkeypatch, capfd):
    small, result = trained
    monkeypatch.setattr(Countdown, "fails_at", 3)
    message = r"^simulator \d of Countdown failed at step 2 of the episode with seed \d+: Runtime"
    with pytest.raises(JaxactError, match=message) as failure:
        evaluate_policy(small.pomdp, result.policy, 11)
    assert isinstance(failure.value.__cause__, RuntimeError)
    assert "Traceback" not in capfd.readouterr().err
    monkeypatch.undo()
    evaluate_policy(small.pomdp, result.policy, 11)


class Widening(Countdown):
    """Observes more than it says."""

    def _seen(self):
        return {"left": np.zeros(2), "digit": 0}


def made_anew(made):
    """Makes another environment each time."""
    made.append(Countdown())
    if len(made) == 2:
        made[-1].action_space = gymnasium.spaces.Discrete(3)
    return made[-1]


def test_spaces_are_checked():
    pomdp = from_gymnasium(Widening)
    with (
        pytest.raises(JaxactError, match=r"float32\[2\], but its space says float32\[1\]"),
        explained(),
    ):
        jax.block_until_ready(pomdp.reset(jax.random.key(0)))
    pomdp = from_gymnasium(functools.partial(made_anew, []), simulators=2)
    with (
        pytest.raises(JaxactError, match=r"all simulators' actions are Discrete\(n=2\), but this"),
        explained(),
    ):
        jax.block_until_ready(jax.vmap(pomdp.reset)(jax.random.split(jax.random.key(0), 2)))


def with_spaces(observation=None, action=None):
    env = Countdown()
    env.observation_space = env.observation_space if observation is None else observation
    env.action_space = env.action_space if action is None else action
    return lambda: env


def test_metrics_have_to_be_there_at_the_end():
    pomdp = from_gymnasium(Countdown, simulators=1, metrics=("takn",))
    with pytest.raises(JaxactError, match=r"end 'takn'; the nearest is 'taken'"), explained():
        play(pomdp, 1, 6, np.ones((6, 1), np.int32))


def test_what_cannot_be_a_world():
    text = gymnasium.spaces.Text(5)
    nested = gymnasium.spaces.Dict({"a": gymnasium.spaces.Dict({"b": text})})
    pair = gymnasium.spaces.Tuple([gymnasium.spaces.Discrete(2)] * 2)
    with pytest.raises(JaxactError, match=r"no space like Gymnasium's Text\("):
        from_gymnasium(with_spaces(nested))
    with pytest.raises(JaxactError, match=r"'observation' is Tuple.*FlattenObservation"):
        from_gymnasium(with_spaces(pair))
    with pytest.raises(JaxactError, match=r"no space like Gymnasium's MultiBinary\(3\)"):
        from_gymnasium(with_spaces(action=gymnasium.spaces.MultiBinary(3)))
    with pytest.raises(JaxactError, match="the nearest is 'CartPole-v1'"):
        from_gymnasium("CartPoll-v1")
    with pytest.raises(JaxactError, match="patience can be given with an id alone"):
        from_gymnasium(Countdown, patience=3)
    with pytest.raises(JaxactError, match="simulators of a simulated world must be at least 1"):
        from_gymnasium(Countdown, simulators=0)
    with pytest.raises(JaxactError, match=r"no space like Gymnasium's Box\(.*\(0,\)"):
        from_gymnasium(with_spaces(gymnasium.spaces.Box(0, 1, (0,))))
    with pytest.raises(JaxactError, match="space of observations is an empty dict"):
        from_gymnasium(with_spaces(gymnasium.spaces.Dict({})))
    with pytest.raises(JaxactError, match="need strings for names, not 1"):
        from_gymnasium(with_spaces(gymnasium.spaces.Dict({1: gymnasium.spaces.Discrete(2)})))
    with pytest.raises(
        JaxactError, match="horizon of simulated episodes must be at least 1, got 0"
    ):
        countdown(horizon=0)
    with pytest.raises(JaxactError, match="held_out_seeds of simulated episodes must be at least"):
        countdown(held_out_seeds=-1)
    with pytest.raises(JaxactError, match=r"1 action_names, but the actions are Discrete\(n=2\)"):
        countdown(action_names=("wait",))
    with pytest.raises(JaxactError, match=r"a sequence of names, as \('taken',\)"):
        from_gymnasium(Countdown, metrics="taken")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (Countdown(), r"environment has to be what makes one .*, but it is <"),
        (lambda: 1 / 0, "the environment cannot be made: ZeroDivisionError: division by zero"),
        (dict, r"made no gymnasium.Env, but a builtins.dict"),
    ],
)
def test_what_makes_no_environment_is_refused(make, message):
    with pytest.raises(JaxactError, match=message):
        from_gymnasium(make)
    with pytest.raises(JaxactError, match=message.replace("environment has", "held_out has")):
        from_gymnasium(Countdown, held_out=make)


def test_options_that_an_environment_lacks_are_refused():
    with pytest.raises(
        JaxactError, match=r"cannot be made: TypeError: CartPoleEnv.* argument 'siz'"
    ):
        from_gymnasium("CartPole-v1", siz=3)
    with pytest.raises(JaxactError, match=r"all simulators' observations are .*'left'.*, but this"):
        from_gymnasium(Countdown, held_out=functools.partial(gymnasium.make, "CartPole-v1"))


class Saying(gymnasium.Env):
    """Says in a step what it was made to say."""

    observation_space = gymnasium.spaces.Dict(
        {"x": gymnasium.spaces.Box(0, 2**40, (1,), np.int64), "kind": gymnasium.spaces.Discrete(3)}
    )
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, said):
        self.said = said

    def reset(self, seed=None, options=None):
        return {"x": np.array([2**30]), "kind": 2}, {}

    def step(self, action):
        return self.said


GOOD = {"x": np.array([1]), "kind": 0}


@pytest.mark.parametrize(
    ("said", "message"),
    [
        (
            (GOOD, 0.0, False, {}),
            "no five of observation, reward, terminated, truncated and `info`",
        ),
        ((GOOD, None, False, False, {}), "its reward is None, where a finite number is needed"),
        ((GOOD, np.nan, False, False, {}), "its reward is nan, where a finite number"),
        ((GOOD, np.ones(2), False, False, {}), r"its reward is \[1\. 1\.\], where a finite number"),
        (({"x": [1]}, 0.0, False, False, {}), r"its space has 'kind', but it observed \['x'\]"),
        ((np.ones(1), 0.0, False, False, {}), "its space has 'kind', but it observed ndarray"),
        (
            (GOOD | {"x": ["a"]}, 0.0, False, False, {}),
            "'x' of what it observed is no array of num",
        ),
        ((GOOD | {"x": [2**35]}, 0.0, False, False, {}), "'x' .* has numbers that are no int32"),
        (
            (GOOD | {"kind": 3}, 0.0, False, False, {}),
            "'kind' of what it observed is 3, not in 0 … 2",
        ),
    ],
)
def test_what_is_said_is_checked(said, message):
    """Before it comes into a compiled program."""
    simulators = from_gymnasium(functools.partial(Saying, said), simulators=1).environment.pool(
        False
    )
    (answer,) = simulators.host.ask({0: 1}).values()
    assert [x.tolist() for x in answer.observation] == [2, [2**30]]
    (answer,) = simulators.host.ask({0: (np.int32(0),)}).values()
    assert isinstance(answer, JaxactError)
    assert re.search(message, str(answer))


def test_a_reward_may_be_an_array_of_one_number():
    make = functools.partial(Saying, (GOOD, np.ones(1), False, False, {}))
    simulators = from_gymnasium(make, simulators=1).environment.pool(False)
    simulators.host.ask({0: 1})
    assert simulators.host.ask({0: (np.int32(0),)})[0].numbers.tolist() == [1, 0, 0, -1]


def test_what_copies_states_is_refused():
    pomdp = countdown()
    with pytest.raises(JaxactError, match="gymnax environments are for worlds in JAX"):
        to_gymnax(pomdp)
    with pytest.raises(JaxactError, match="sweeps are for worlds in JAX"):
        sweep(experiment(pomdp), {"pipeline.learning_rate": log_uniform(1e-4, 1e-2)})
    with pytest.raises(JaxactError, match="the sampler begins episodes of other simulators"):
        dataclasses.replace(pomdp, sampler=countdown().sampler)


def test_actions_in_a_dict_and_a_tuple():
    """They come to the environment as its space has them."""
    seen = []

    class Recorder(Countdown):
        def step(self, action):
            seen.append(action)
            return super().step(np.int64(1))

    box = gymnasium.spaces.Box(np.array([-1, -2]), np.array([1, 2]), dtype=np.float64)
    parts = {"push": box, "pair": gymnasium.spaces.Tuple([gymnasium.spaces.Discrete(3)] * 2)}

    def make():
        env = Recorder()
        env.action_space = gymnasium.spaces.Dict(parts)
        return env

    pomdp = from_gymnasium(make, simulators=1)
    key = jax.random.key(0)
    state, _ = pomdp.reset(key)
    action = {"pair": (jnp.int32(1), jnp.int32(2)), "push": jnp.full(2, 1.5)}
    _, step = pomdp.step(key, state, action)
    assert float(step.observation["left"][0]) >= 0
    (given,) = seen
    assert given["pair"] == (1, 2)
    np.testing.assert_array_equal(given["push"], [1.0, 1.5])
    assert given in gymnasium.spaces.Dict(parts)


@pytest.mark.slow
def test_cart_pole_is_solved():
    from examples.gymnasium_cartpole import experiment as cart_pole

    result = train(cart_pole, evaluate_every=0, evaluation_episodes=100, progress=False)
    assert result.evaluation.episode_return.mean() >= 475
    again = evaluate_policy(cart_pole.pomdp, result.policy, 100, seed=7)
    assert again.episode_return.mean() >= 475
