"""The batch belongs to the experiment: on any number of devices the same is learnt.

Devices are simulated in processes of their own, since their number is fixed when JAX starts.
"""

import json
import os
import socket
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from jaxact.checkpoints import Checkpoints
from jaxact.logs import read_metrics

SCRIPT = """
    import json, sys
    import jax
    import numpy as np
    from jaxact import JaxactError, Stage, train
    from jaxact.checkpoints import Checkpoints
    from jaxact.losses import PPO, Imitation
    from jaxact.moments import Moments
    from jaxact.program import Program, choose_devices
    from jaxact.train_state import make_key
    from tests.tiny import curriculum, experiment, raw

    counts, kind = json.loads(sys.argv[1]), sys.argv[2]
    if kind == "replay":
        from tests.jaxact.test_value_training import r2d2

        small = r2d2(start_after=64)
    elif kind == "normalized":
        from tests.jaxact import test_normalized

        small = test_normalized.experiment()
    elif kind == "agents":
        from tests.jaxact.test_agents import of_crowd

        small = of_crowd(3, (Stage({"ppo": PPO()}, steps=256),), "body")
    elif kind == "demonstrations":
        from jaxact.collect import collect
        from jaxact.storages import DemonstrationStorage
        from tests.corridor import corridor

        collect(corridor(), "recorded", 90, world="corridor", progress=False)
        recorded = DemonstrationStorage(
            losses={"imitation": Imitation()}, path="recorded", lanes=8, length=8, updates=2
        )
        stage = Stage({"ppo": PPO()}, steps=256, storages={"recorded": recorded})
        small = experiment(stages=(stage,))
    else:
        stage = Stage({"ppo": PPO(), "imitation": Imitation()}, steps=256, teacher_forcing=0.5)
        pomdp = curriculum() if kind == "curriculum" else None
        small = experiment(pomdp, stages=(stage,), learning_rate=1e-2)
    program = {n: Program(small, choose_devices(n)) for n in counts}
    advance = {n: program[n].stage(0, 1) for n in counts}

    def updates(n, state, count):
        rows = []
        for _ in range(count):
            given = program[n].numbers(), np.int32(1), program[n].data
            state, metrics = advance[n](state, *given)
            rows.append(jax.tree.map(lambda x: float(x[0]), metrics))
        return state, rows

    def host(tree):
        return [np.asarray(raw(x)) for x in jax.tree.leaves(tree)]

    def lanes(state):
        return host((state.lanes.state, state.lanes.previous_action, state.lanes.key))

    first, ends, rows, statistics = {}, {}, {}, {}
    for n in counts:
        state = program[n].start(make_key(3))
        one = state.lanes.is_first
        assert len(one.sharding.device_set) == n
        assert state.updates.sharding.is_fully_replicated
        state, begun = updates(n, state, 1)
        first[n] = lanes(state)
        if n == max(counts):
            Checkpoints("checkpoints").save(64, state, metadata={})
        if kind == "normalized":
            assert isinstance(test_normalized.moments_of(state.params), Moments)
            statistics[n] = host(test_normalized.moments_of(state.params))
        state, others = updates(n, state, 3)
        ends[n], rows[n] = host((state.params, state.sampler)), begun + others

    least, most = min(counts), max(counts)
    for n in counts:
        for a, b in zip(first[n], first[least], strict=True):
            np.testing.assert_array_equal(a, b)
        for name in ("episodes/count", "episodes/length", "train/forced"):
            assert rows[n][0][name] == rows[least][0][name], name
        # Sums over devices are taken in another order: a rounding error of 1e-7 relative, grown
        # by Adam's division by the gradients' size over twelve steps.
        for a, b in zip(ends[n], ends[least], strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4)
        for one, other in zip(rows[n], rows[least], strict=True):
            for name in one:
                np.testing.assert_allclose(one[name], other[name], rtol=1e-3, atol=1e-4)

    for n in statistics:
        # Of the very same observations; only the order of the sums differs.
        for a, b in zip(statistics[n], statistics[least], strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6)

    like = program[least].like()
    state = Checkpoints("checkpoints").restore(None, like).state
    assert len(state.lanes.is_first.sharding.device_set) == least
    state, _ = updates(least, state, 3)
    for a, b in zip(host((state.params, state.sampler)), ends[least], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4)

    try:
        train(small, devices=5, progress=False)
    except JaxactError as error:
        assert "5 devices were asked for, but jax sees 4 (cpu)" in str(error), error
    try:
        Program(experiment(lanes=12, minibatches=4), choose_devices(4))
    except JaxactError as error:
        assert "12 lanes do not divide into 4 minibatches on 4 device(s)" in str(error), error
        print("done")
"""

ROOT = Path(__file__).parents[2]


def environment(devices):
    names = {"JAX_NUM_CPU_DEVICES": str(devices), "PYTHONPATH": str(ROOT)}
    return os.environ | names


def run(counts, kind, directory):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(SCRIPT), json.dumps(counts), kind],
        env=environment(4),
        cwd=directory,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("counts", "kind"),
    [
        ([1, 4], "plain"),
        pytest.param([1, 4], "replay", marks=pytest.mark.slow),
        pytest.param([1, 2], "normalized", marks=pytest.mark.slow),
        pytest.param([1, 2], "agents", marks=pytest.mark.slow),
        pytest.param([1, 4], "demonstrations", marks=pytest.mark.slow),
        pytest.param([1, 2, 4], "plain", marks=pytest.mark.slow),
        pytest.param([1, 2, 4], "curriculum", marks=pytest.mark.slow),
    ],
)
def test_any_number_of_devices_learns_the_same(counts, kind, tmp_path):
    """First the very same steps, then the same but for rounding; checkpoints move between them.

    A curriculum draws the same episodes, too, and learns the same from them; a replay holds and
    draws the same sequences, and so do recorded demonstrations.
    """
    ended = run(counts, kind, tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip() == "done"


EMPTY_LEAF = """
    import jax
    from jaxact import Experiment, Stage, TrainingPipeline, train
    from jaxact.losses import PPO
    from jaxact.models import GRU, ActorCritic, InstructedGrid
    import envs_jax

    pomdp = envs_jax.make("BabyAI-PickupLoc-v0")
    state, _ = jax.eval_shape(pomdp.reset, jax.random.key(0))
    assert any(leaf.size == 0 for leaf in jax.tree.leaves(state))
    pipeline = TrainingPipeline(
        (Stage({"ppo": PPO()}, 1024),), lanes=8, rollout_length=16, epochs=1, minibatches=2
    )
    model = ActorCritic(pomdp.action_space, InstructedGrid(16), GRU(16))
    experiment = Experiment("small", pomdp, model, pipeline)
    result = train(experiment, devices=2, log_every=128, evaluation_episodes=0, progress=False)
    print(len(result.metrics["step"]))
"""


@pytest.mark.slow
def test_levels_may_have_leaves_without_elements(tmp_path):
    """XLA would hand these back replicated, and the next chunk's program refuse them."""
    command = [sys.executable, "-c", textwrap.dedent(EMPTY_LEAF)]
    ended = subprocess.run(
        command, env=environment(2), cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip() == "8"


PROCESS = """
    import os, signal, sys
    import jax

    if len(sys.argv) > 1:
        jax.config.update("jax_cpu_collectives_implementation", "gloo")
        jax.distributed.initialize(sys.argv[1], num_processes=2, process_id=int(sys.argv[2]))

    import numpy as np
    from jaxact import JaxactError, train
    from jaxact.train import Run
    from tests.tiny import OPTIONS, UPDATE, experiment

    assert len(jax.devices()) == 2
    small, process = experiment(learning_rate=1e-2), jax.process_index()
    after_chunk = Run._after_chunk

    def after(self, state, before, rows):
        if process == 1 and self._steps(state) == 4 * UPDATE:
            os.kill(os.getpid(), signal.SIGTERM)
        after_chunk(self, state, before, rows)

    Run._after_chunk = after
    if process == 0:
        open("file", "w").close()
    try:
        train(small, output="file/runs", **OPTIONS)
    except JaxactError as error:
        assert str(error).startswith("cannot create a run in file/runs"), error
    result = train(small, output="runs", **OPTIONS)
    if jax.process_count() == 2:
        # Only the second was told to stop, but both did.
        assert result.interrupted == signal.SIGTERM
        result = train(small, resume=result.run, **OPTIONS)
    params = np.concatenate([np.ravel(x) for x in jax.tree.leaves(result.policy.params)])
    print(result.run, params.astype(np.float64).sum(), result.evaluation.length.sum())
"""


@pytest.mark.slow
def test_two_processes_train_one_run(tmp_path):
    """They learn what one process with two devices does, in one directory; stopped and resumed."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        address = f"localhost:{free.getsockname()[1]}"

    def start(devices, directory, *arguments):
        directory.mkdir(exist_ok=True)
        return subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(PROCESS), *arguments],
            env=environment(devices),
            cwd=directory,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    both, alone = tmp_path / "both", tmp_path / "alone"
    started = [start(1, both, address, "0"), start(1, both, address, "1"), start(2, alone)]
    results = []
    try:
        for process in started:
            printed, errors = process.communicate(timeout=300)
            assert process.returncode == 0, errors
            results.append(printed.splitlines()[-1].split())
    finally:
        for process in started:
            process.kill()
            process.communicate()
    assert results[0] == results[1]
    runs = [both / results[0][0], alone / results[2][0]]
    for run, directory in zip(runs, (both, alone), strict=True):
        assert list((directory / "runs" / "corridor").iterdir()) == [run]
        assert Checkpoints(run / "checkpoints").steps() == [128, 256, 384, 512]
        assert (run / "evaluation" / "000000000512.json").is_file()
    for one, other in zip(*map(read_metrics, runs), strict=True):
        assert one == pytest.approx(other, rel=1e-3, abs=1e-4, nan_ok=True)
    numbers = [[float(x) for x in result[1:]] for result in (results[0], results[2])]
    assert numbers[0] == pytest.approx(numbers[1], rel=1e-3)
