import dataclasses
import json
import math
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary

from jaxact import command_line
from jaxact.curves import Curve, find_runs, read_curves
from jaxact.errors import JaxactError
from jaxact.figure import steps_text
from jaxact.groups import band, group_runs
from jaxact.logs import read_hours
from jaxact.plot import plot_runs
from jaxact.runs import create_run
from jaxact.statistics import confidence_interval, mean_interval

RESULTS = Path(__file__).parents[2] / "docs" / "results"


def curve(step: Any, value: Any) -> Curve:
    step, value = np.array(step, np.float64), np.array(value, np.float64)
    unknown = np.full_like(step, np.nan)
    return Curve(step, value, unknown, unknown)


def make_run(
    directory: Path,
    seed: int,
    rows: list[dict[str, Any]],
    evaluations: dict[str, tuple[int, int, int]] | None = None,
    name: str = "corridor",
    **values: Any,
) -> Path:
    """Writes a run; `evaluations` are (step, successes, episodes) by the file's name."""
    experiment = {"name": name, "pipeline": {"lanes": 8, "rate": 0.1} | values}
    fingerprint = json.dumps([len(values), name, values])
    config = {"seed": seed, "fingerprint": fingerprint, "experiment": experiment}
    run = create_run(directory, name, config, run_id=f"{seed}{''.join(map(str, values.values()))}")
    (run / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    (run / "evaluation").mkdir()
    for file, (step, successes, n) in (evaluations or {}).items():
        interval = list(confidence_interval(successes, n))
        success = {"mean": successes / n, "interval": interval}
        record = {"step": step, "seed": seed, "greedy": False, "episodes": n, "success": success}
        (run / "evaluation" / f"{file}.json").write_text(json.dumps(record))
    return run


def rows(steps: list[int], slope: float = 0.001, **others: float) -> list[dict[str, Any]]:
    tags = {"stage": 0.0, **{name.replace("__", "/"): x for name, x in others.items()}}
    return [
        {"step": s, "train/success": s * slope, "train/return": -s * slope, **tags} for s in steps
    ]


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Two seeds that were logged at different steps, and one of another experiment."""
    make_run(tmp_path, 0, rows([100, 200, 300]), {"0100": (100, 20, 40), "0300": (300, 40, 40)})
    make_run(tmp_path, 1, rows([150, 250, 300], 0.002), {"0300": (300, 30, 40)})
    make_run(tmp_path, 0, rows([100, 300]), {"0300": (300, 10, 40)}, name="other")
    return tmp_path


def test_seeds_are_interpolated_at_the_steps_of_all() -> None:
    seeds = [curve([0, 100, 200], [0, 10, 40]), curve([50, 150, 250], [1, 3, 5])]
    median = band(seeds, "median")
    assert median is not None
    assert median.x.tolist() == [50, 100, 150, 200]  # where both are known
    values = np.array([[5, 10, 25, 40], [1, 2, 3, 4]])
    np.testing.assert_allclose(median.line, np.median(values, 0))
    np.testing.assert_allclose(median.low, np.percentile(values, 25, axis=0))
    np.testing.assert_allclose(median.high, np.percentile(values, 75, axis=0))
    mean = band(seeds, "mean")
    assert mean is not None
    assert (mean.spread, median.spread) == ("seeds", "seeds")
    np.testing.assert_allclose(mean.line, values.mean(0))
    for index, column in enumerate(values.T):
        assert (mean.low[index], mean.high[index]) == mean_interval(column)
    # 3 ± t(0.975; 1) · 2: Student's table has 12.706.
    assert mean.high[0] == pytest.approx(3 + 12.706 * 2, rel=1e-4)


def test_steps_that_agree_are_not_touched() -> None:
    values = np.random.default_rng(0).normal(size=(3, 20))
    steps = np.cumsum(np.random.default_rng(1).uniform(1, 9, 20))
    common = band([curve(steps, one) for one in values], "median")
    assert common is not None
    assert common.x.tobytes() == steps.tobytes()
    assert common.line.tobytes() == np.median(values, 0).tobytes()


def test_no_line_crosses_a_gap() -> None:
    gap = curve([0, 10, 20, 30], [1, math.nan, 3, 4])
    common = band([gap, curve([0, 5, 25, 30], [1, 1, 1, 1])], "mean")
    assert common is not None
    assert common.x.tolist() == [0, 5, 10, 20, 25, 30]
    assert common.line.tolist() == pytest.approx([1, math.nan, math.nan, 2, 2.25, 2.5], nan_ok=True)
    assert np.isnan(common.low[1:3]).all()
    assert band([curve([0, 10], [1, 1]), curve([20, 30], [1, 1])], "mean") is None
    assert band([curve([0, 1, 9], [1, math.nan, 1]), curve([1, 8], [1, 1])], "median") is None


def test_smoothing_is_a_mean_over_a_window_of_steps() -> None:
    rough = curve([0, 10, 20, 50, 60, 70], [0, 3, 6, math.nan, 10, 20])
    assert rough.smoothed(20).value.tolist() == pytest.approx(
        [1.5, 3, 4.5, math.nan, 15, 15], nan_ok=True
    )
    assert rough.smoothed(0).value.tobytes() == rough.value.tobytes()


def test_what_is_read_of_a_run(tmp_path: Path) -> None:
    lines = [
        {"step": 100, "stage": 0.0, "train/success": 0.5, "losses/a": 1.0},
        {"step": 200, "stage": 1.0, "train/success": None},
        {"step": 200, "evaluation/success": 0.1},
        {"step": 300, "stage": 2.0, "train/success": 0.75, "losses/a": 2.0},
    ]
    evaluations = {"0200": (200, 9, 10), "0100": (100, 1, 10), "0300-seed3-greedy": (300, 5, 10)}
    run = make_run(tmp_path, 7, lines, evaluations)
    elsewhere = json.loads((run / "evaluation" / "0200.json").read_text()) | {"overrides": ["a=1"]}
    (run / "evaluation" / "0200-seed0-sampled.json").write_text(json.dumps(elsewhere))
    with (run / "metrics.jsonl").open("a") as file:
        file.write('{"step": 400, "train/succ')  # it goes on
    (read,) = read_curves(run)
    assert (read.name, read.seed, read.last_step) == ("corridor", 7, 300)
    after = "evaluation-seed3-greedy/success"
    assert set(read.curves) == {"stage", "train/success", "losses/a", "evaluation/success", after}
    success = read.curves["train/success"]  # no episode finished: nothing known, but no gap
    assert (success.step.tolist(), success.value.tolist()) == ([100, 300], [0.5, 0.75])
    loss = read.curves["losses/a"]  # a stage without it
    assert loss.step.tolist() == [100, 200, 300]
    assert loss.value.tolist() == pytest.approx([1, math.nan, 2], nan_ok=True)
    held_out = read.curves["evaluation/success"]
    assert (held_out.step.tolist(), held_out.value.tolist()) == ([100, 200], [0.1, 0.9])
    assert (held_out.low[1], held_out.high[1]) == confidence_interval(9, 10)


def test_runs_are_found_once_each(runs: Path) -> None:
    found = find_runs([runs / "other", runs, runs / "corridor" / "1"])
    assert [str(path.relative_to(runs)) for path in found] == [
        "other/0",
        "corridor/0",
        "corridor/1",
    ]


def test_runs_of_an_experiment_are_one_group(tmp_path: Path) -> None:
    for seed in (3, 1):
        make_run(tmp_path, seed, rows([100]))
        make_run(tmp_path, seed, rows([100]), rate=0.2)
    make_run(tmp_path, 0, rows([100]), name="other")
    again = make_run(tmp_path / "again", 1, rows([50, 200]))
    read = [one for path in find_runs([tmp_path]) for one in read_curves(path)]
    groups, repeated = group_runs(read)
    seeds = {group.label: [run.seed for run in group.runs] for group in groups}
    assert seeds == {"corridor, rate=0.1": [1, 3], "corridor, rate=0.2": [1, 3], "other": [0]}
    assert repeated == 1
    assert groups[0].runs[0].path == again  # it came farther
    assert [group.label for group in group_runs(read, ["a", "b", "c"])[0]] == ["a", "b", "c"]
    with pytest.raises(JaxactError, match=r"2 labels for 3 experiments: corridor \(2 seeds\), cor"):
        group_runs(read, ["a", "b"])


def test_experiments_that_differ_in_much_are_told_apart_by_their_fingerprints(
    tmp_path: Path,
) -> None:
    make_run(tmp_path, 0, rows([100]))
    make_run(tmp_path, 0, rows([100]), rate=0.2, lanes=16, clip=0.1)
    read = [one for path in find_runs([tmp_path]) for one in read_curves(path)]
    labels = [group.label for group in group_runs(read)[0]]
    assert labels == [f"corridor ({run.fingerprint[:7]})" for run in read]
    assert len(set(labels)) == 2


def test_a_figure_has_the_medians(runs: Path) -> None:
    plot = plot_runs([runs], metrics=["train/success", "train/return+train/success"])
    assert [axes.get_title("left") for axes in plot.figure.axes] == [
        "train/success",
        "train/return; thin: train/success",
    ]
    line, other = plot.figure.axes[0].lines
    assert line.get_xdata().tolist() == [150, 200, 250, 300]
    np.testing.assert_allclose(line.get_ydata(), np.array([150, 200, 250, 300]) * 0.0015)
    assert other.get_xdata().tolist() == [100, 300]
    assert len({line.get_color(), other.get_color()}) == 2
    (legend,) = plot.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["corridor (2 seeds)", "other"]
    assert len(plot.figure.axes[0].collections) == 2  # bands
    assert plot.notes == ()


def test_the_page_has_what_changes(tmp_path: Path) -> None:
    same = {"losses__ppo__weight": 1.0, "train__teacher_forcing": 0.0, "losses__total": 1.0}
    terms = {"train__reward__step": -1.0, "train__reward__success": 1.0}
    for seed in (0, 1):
        lines = rows([100, 200], **same, **terms, losses__ppo__value=float(seed))
        make_run(tmp_path, seed, lines, {"0200": (200, 1, 10)})
    titles = [axes.get_title("left") for axes in plot_runs([tmp_path]).figure.axes]
    assert titles == [
        "success (evaluation; thin: train)",
        "train/return",
        "losses/ppo/value",
    ]
    make_run(
        tmp_path, 0, rows([100, 200], **{**same, **terms, "train__teacher_forcing": 1.0}), rate=1
    )
    titles = [axes.get_title("left") for axes in plot_runs([tmp_path]).figure.axes]
    assert titles[2] == "train/teacher_forcing"
    (tmp_path / "constant").mkdir()
    make_run(tmp_path / "constant", 0, [{"step": 1, "train/success": 1.0}])
    (axes,) = plot_runs([tmp_path / "constant"]).figure.axes
    assert axes.get_title("left") == "train/success"


def test_final_values(runs: Path) -> None:
    plot = plot_runs([runs], metrics=["evaluation/success", "train/return"], statistic="mean")
    success, single, back, _ = plot.finals
    assert (success.experiment, success.seeds, success.x, success.value) == (
        "corridor",
        2,
        300,
        0.875,
    )
    assert (success.low, success.high) == mean_interval([1.0, 0.75])
    # Of one seed, Wilson's interval over its episodes.
    assert (single.low, single.high, single.spread) == (*confidence_interval(10, 40), "episodes")
    assert back.value == pytest.approx(-0.45)
    assert json.loads(json.dumps(plot.to_json()))["finals"][1] == {
        "experiment": "other",
        "metric": "evaluation/success",
        "seeds": 1,
        "value": 0.25,
        "low": single.low,
        "high": single.high,
        "spread": "episodes",
        "steps": 300.0,
    }
    assert plot_runs([runs], metrics=["train/return"]).table() == "\n".join(
        (
            "experiment  metric        seeds  steps  median  interval",
            "corridor    train/return      2    300   -0.45  [-0.525, -0.375]  quartiles of seeds",
            "other       train/return      1    300    -0.3",
        )
    )


def test_files_are_the_same_every_time(runs: Path, tmp_path: Path) -> None:
    for name in ("a.png", "b.svg"):
        png, svg = plot_runs([runs]).save(tmp_path / "made" / name)
        with Image.open(png) as picture:
            assert min(picture.size) > 300
    for suffix in (".png", ".svg"):
        one, other = ((tmp_path / "made" / f"{name}{suffix}").read_bytes() for name in "ab")
        assert one == other
    assert "<dc:date>" not in svg.read_text()
    with pytest.raises(JaxactError, match=r"curves.pdf should end in .png or .svg"):
        plot_runs([runs]).save("curves.pdf")
    with pytest.raises(JaxactError, match="cannot write"):
        plot_runs([runs]).save(png / "curves.png")


def test_notes_tell_what_is_not_drawn(runs: Path) -> None:
    make_run(runs, 2, rows([100, 200]))
    make_run(runs, 5, [], name="empty")
    lines = rows([100, 200], losses__ppo=1.0)
    make_run(runs, 0, lines, name="ppo")
    plot = plot_runs([runs], metrics=["losses/ppo", "train/return"])
    assert set(plot.notes) == {
        f"{runs}/empty/5 left out, as it has no curves",
        "corridor is drawn as far as seed 2 has come: 200 of 300 steps",
        "corridor has no losses/ppo",
        "other has no losses/ppo",
    }
    assert plot.figure.axes[1].lines[0].get_xdata().tolist() == [150, 200]


def test_stages_that_ended_at_different_steps_are_noted(tmp_path: Path) -> None:
    """As with early stopping: where both are known, one is in another stage than the other."""
    for seed, change in enumerate((200, 300)):
        lines = rows([100, 200, 300, 400])
        for line in lines:
            line["stage"] = float(line["step"] >= change)
        make_run(tmp_path, seed, lines)
    assert plot_runs([tmp_path]).notes == (
        "corridor has seeds that changed stages at different steps (seed 0: 200; seed 1: 300)",
    )


def test_runs_without_the_metric(runs: Path) -> None:
    with pytest.raises(
        JaxactError, match=r"unknown metric 'train/sucess'; the nearest is 'train/su"
    ):
        plot_runs([runs], metrics=["train/sucess"])
    make_run(runs, 0, rows([100], losses__ppo=1.0), name="stages")
    make_run(runs, 1, rows([200, 300], losses__ppo=1.0), name="stages")
    make_run(runs, 2, rows([200, 300]), name="stages")
    with pytest.raises(JaxactError, match=r"which seed 2 has not logged"):
        plot_runs([runs / "stages"], metrics=["losses/ppo"])
    seeds = [runs / "stages" / seed for seed in "01"]
    with pytest.raises(
        JaxactError,
        match=r"losses/ppo at no step with all seeds \(seed 0 from 100 to 100, seed 1 from 2",
    ):
        plot_runs(seeds, metrics=["losses/ppo"])


def test_what_is_no_run(runs: Path) -> None:
    with pytest.raises(JaxactError, match="name at least one run"):
        plot_runs([])
    with pytest.raises(JaxactError, match="does not exist: unknown run '3'; the nearest is"):
        plot_runs([runs / "corridor" / "3"])
    (runs / "nothing").mkdir()
    with pytest.raises(JaxactError, match=r"nothing is not a run: it has no config\.json"):
        plot_runs([runs, runs / "nothing"])
    make_run(runs / "begun", 0, [])
    with pytest.raises(JaxactError, match="nothing has been logged in"):
        plot_runs([runs / "begun"])
    create_run(runs / "strange", "x", {"seed": 1})
    with pytest.raises(JaxactError, match="lacks seed, fingerprint or experiment"):
        plot_runs([runs / "strange"])
    (runs / "corridor" / "0" / "evaluation" / "0300.json").write_text("{")
    with pytest.raises(JaxactError, match=r"0300\.json is not valid JSON"):
        plot_runs([runs])
    with pytest.raises(JaxactError, match="smooth must be a number of environment steps, got -1"):
        plot_runs([runs], smooth=-1)


def test_committed_results_are_drawn() -> None:
    files = sorted(RESULTS.glob("*.json"))
    plot = plot_runs(files, metrics=["evaluation/success+train/success"], statistic="mean")
    results = {file: json.loads(file.read_text()) for file in files}
    trained = [result for result in results.values() if "runs" in result]
    finals = [final for final in plot.finals if final.metric == "evaluation/success"]
    assert [final.experiment for final in finals] == [one["name"] for one in trained]
    for final, one in zip(finals, trained, strict=True):
        success = one["final"]["success"]
        expected = [success["mean"], *success["interval"]]
        assert [final.value, final.low, final.high] == pytest.approx(expected, rel=1e-12)
        assert final.seeds == len(one["seeds"])
    others = [file for file, result in results.items() if "runs" not in result]
    left_out = [f"{file} left out, as it has no curves" for file in others]
    assert plot.notes == (*left_out, "babyai_gotolocal_bc_offline has no train/success")


def write_events(path: Path, events: list[Event]) -> None:
    data = [event.SerializeToString() for event in events]
    framed = [struct.pack("<Q", len(one)) + bytes(4) + one + bytes(4) for one in data]
    path.write_bytes(b"".join(framed))


def event(seconds: float, step: int, **others: Any) -> Event:
    value = Summary(value=[Summary.Value(tag="train/success", simple_value=0.5)])
    return Event(wall_time=seconds, step=step, **(others or {"summary": value}))


def test_hours_are_those_of_training(tmp_path: Path) -> None:
    """An hour for 100 steps; stopped after 300, it is resumed at 200 a day later."""
    run = make_run(tmp_path, 0, rows([100, 200, 300, 400]), {"0400": (400, 1, 2)})
    with pytest.raises(JaxactError, match="has no TensorBoard events"):
        plot_runs([run], hours=True, metrics=["train/return"])
    first = [event(3600 * hour, 100 * hour) for hour in range(4)]
    write_events(run / "events.out.tfevents.10.host", first)
    start = event(90_000, 201, session_log=SessionLog(status=SessionLog.START))
    later = [event(90_000, 0, file_version="brain.Event:2"), start]
    later += [event(90_000 + 3600 * hour, 200 + 100 * hour) for hour in (1, 2)]
    write_events(run / "events.out.tfevents.20.host", later)
    with (run / "events.out.tfevents.20.host").open("ab") as file:
        file.write(struct.pack("<Q", 100) + b"cut short")
    steps, hours = read_hours(run)
    assert dict(zip(steps.tolist(), hours.tolist(), strict=True)) == {
        0: 0,
        100: 1,
        200: 2,
        300: 3,
        400: 4,
    }
    plot = plot_runs([run], hours=True, metrics=["train/return"])
    assert plot.figure.axes[0].lines[0].get_xdata().tolist() == [1, 2, 3, 4]
    assert plot.figure.axes[0].get_xlabel() == "hours"
    assert plot.to_json()["finals"][0]["hours"] == 4


def test_steps_are_written_short() -> None:
    assert [steps_text(x) for x in (0, 1000, 1_500_000)] == ["0", "1k", "1.5M"]


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    def run(*arguments: Any) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["plot", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            command_line.run_plot()
        printed = capsys.readouterr()
        code = ended.value.code
        return int(code or 0), printed.out, printed.err

    return run


def test_the_command_line(call: Any, runs: Path) -> None:
    output = runs / "figures" / "curves.png"
    code, printed, errors = call(
        *(runs, "--metric", "evaluation/success+train/success", "--metric", "train/return"),
        *("--statistic", "mean", "--smooth", "100", "--label", "mine", "--label", "theirs"),
        *("--output", output, "--table"),
    )
    assert (code, errors) == (0, "")
    *table, written = printed.splitlines()
    assert len(table) == 1 + 3 * 2
    assert table[1].split()[:4] == ["mine", "evaluation/success", "2", "300"]
    files = [output.with_suffix(suffix) for suffix in (".png", ".svg", ".json")]
    assert written == f"written: {' '.join(map(str, files))}"
    assert all(file.is_file() for file in files)
    assert len(json.loads(files[2].read_text())["finals"]) == 6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "name at least one run"),
        (("nowhere",), "nowhere does not exist"),
        (("RUNS", "--metric", "train/retrun"), "the nearest is 'train/return'"),
        (("RUNS", "--output", "curves.gif"), "should end in .png or .svg"),
    ],
)
def test_bad_input_is_one_sentence(
    call: Any, runs: Path, arguments: tuple[str, ...], message: str
) -> None:
    code, printed, errors = call(*(runs if one == "RUNS" else one for one in arguments))
    assert (code, printed) == (2, "")
    assert errors.startswith("jaxact.plot: ")
    assert message in errors
    assert errors.count("\n") == 1


def test_help_lists_every_flag(call: Any) -> None:
    code, printed, _ = call("--help")
    assert code == 0
    for name in {field.name for field in dataclasses.fields(command_line.PlotArguments)} - {"runs"}:
        assert f"--{name}" in printed
    assert "usage: python -m jaxact.plot" in printed
