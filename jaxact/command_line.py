"""The command lines of `python -m jaxact.train`, `.evaluate`, `.collect`, `.sweep` and `.plot`."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import tyro

from jaxact.errors import JaxactError
from jaxact.options import Options, SweepOptions

Arguments = TypeVar("Arguments")


@dataclass(frozen=True)
class TrainArguments(Options):
    """Trains an experiment, or goes on with a run."""

    experiment: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="EXPERIMENT")] = (
        None
    )
    """A Python file that defines `experiment`, a dotted module name, or the name of a shipped
    example; FILE:KEY is one of the file's `experiments`. With --resume it may be left out: the
    run's own copy is used."""

    seed: int = 0
    """Of everything random; a resumed run keeps its own."""

    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """PATH=VALUE overrides one value of the experiment, for example
    pipeline.stages.0.losses.ppo.clip=0.2; may be repeated. --dry-run lists them all."""

    dry_run: bool = False
    """Print the parts, their values, shapes, parameters, FLOPs and memory; then stop."""

    compilation_cache: bool = False
    """Keep compiled programs in the user's cache directory, so that later runs start at once."""

    output: Path | None = Path("runs")
    """Directory for runs: the run goes to OUTPUT/<experiment>/<time of day>."""


@dataclass(frozen=True)
class EvaluateArguments:
    """Evaluates a run's policy, or the expert of its task, on held-out episodes."""

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """A run's directory; or, with --expert, an experiment as jaxact.train takes it."""
    episodes: int = 1000
    """How many held-out episodes are played, each once."""
    seed: int = 0
    """Of the episodes: the same seed gives the same episodes to every policy."""
    greedy: bool = False
    """Take the most likely actions instead of samples."""
    checkpoint: str = "newest"
    """newest, best, all, or the step of a checkpoint."""
    expert: bool = False
    """Evaluate the task's expert instead of a policy."""
    video: Path | None = None
    """Film the first held-out episode into this file (.gif or .mp4)."""
    features: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Show this intermediate of the model in the film, for example encoder/Convolution_0; may be
    repeated."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """PATH=VALUE overrides one value of the experiment, to evaluate under other conditions."""


@dataclass(frozen=True)
class CollectArguments:
    """Records whole episodes of an expert, or of a run's policy, as demonstrations.

    The same command goes on with what was interrupted, to the same result.
    """

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="EXPERIMENT")]
    """An experiment as jaxact.train takes it, the id of a world, or a run's directory."""
    output: Path
    """The directory to write."""
    episodes: int
    """How many: those numbered 0 to EPISODES - 1 of the seed's stream, however long they are."""
    seed: int = 0
    """Of the episodes, none of which is a held-out one of jaxact.evaluate."""
    expert: bool = False
    """The task's expert acts; that is so unless there is a --checkpoint."""
    checkpoint: str | None = None
    """newest, best or the step of a checkpoint: the run's policy acts."""
    greedy: bool = False
    """The policy takes the most likely actions instead of samples."""
    successful_only: bool = False
    """Record the first EPISODES of those with success."""
    final_observations: bool = False
    """Keep what was seen after the last step of each episode: for bootstrapping, and Minari."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """PATH=VALUE overrides one value of the experiment, or of the world given by its id."""
    progress: bool = True
    """Show how far it is."""


@dataclass(frozen=True)
class PlotArguments:
    """Draws learning curves of runs; those that differ only in the seed become one with a band."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN...")]
    """Runs' directories, directories with runs inside, or files such as those in docs/results."""
    metric: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Draw this metric, for example train/return; may be repeated, for a panel each. Joined by +,
    as in evaluation/success+train/success, several share one (default: a page of what there is)."""
    statistic: Literal["median", "mean"] = "median"
    """Median over seeds with the quartiles, or mean with Student's 95 % interval."""
    smooth: float = 0
    """Environment steps over which what was logged while training is averaged."""
    hours: bool = False
    """Draw against hours of training instead of environment steps."""
    label: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """What the legend calls an experiment; to be repeated, in the order of the runs."""
    output: Path = Path("curves.png")
    """The figure's file, .png or .svg: both are written."""
    table: bool = False
    """Print the final values with their intervals, and write them beside the figure as JSON."""


@dataclass(frozen=True)
class SweepArguments(SweepOptions):
    """Searches an experiment's numbers at random, goes on with a sweep, or compares sweeps."""

    experiment: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="EXPERIMENT")] = (
        None
    )
    """As jaxact.train takes it. With --resume it may be left out: the sweep's own copy is used."""

    draw: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """PATH=RANGE draws one number of the experiment, for example
    pipeline.learning_rate=log_uniform(1e-4,0.5); may be repeated. Ranges are uniform(LOW,HIGH),
    log_uniform(LOW,HIGH), normal(MEAN,DEVIATION), choice(A,B,...) and in_order(A,B,...), which
    takes its values one after the other; PATH,PATH=RANGE shares a draw."""

    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """PATH=VALUE overrides one value of the experiment; may be repeated."""

    output: Path | None = Path("sweeps")
    """Directory for sweeps: it goes to OUTPUT/<experiment>/<time of day>."""

    report: tuple[Path, ...] = ()
    """Sweeps' directories: train nothing, but print and draw what their searches can expect."""

    metric: str = "success"
    """What is best at the last evaluation: success, return, length or a task's metric."""

    smallest: bool = False
    """The smallest is the best."""

    figure: Path | None = None
    """Where the report is drawn, once as .png and once as .svg (default: expected_best in the first
    sweep's directory)."""


def run_train() -> None:
    """Runs `python -m jaxact.train`."""
    _run("jaxact.train", TrainArguments, _train)


def run_evaluate() -> None:
    """Runs `python -m jaxact.evaluate`."""
    _run("jaxact.evaluate", EvaluateArguments, _evaluate)


def run_collect() -> None:
    """Runs `python -m jaxact.collect`."""
    _run("jaxact.collect", CollectArguments, _collect)


def run_plot() -> None:
    """Runs `python -m jaxact.plot`."""
    _run("jaxact.plot", PlotArguments, _plot)


def run_sweep() -> None:
    """Runs `python -m jaxact.sweep`."""
    _run("jaxact.sweep", SweepArguments, _sweep)


def _run(
    program: str, arguments: type[Arguments], command: Callable[[Arguments], int | None]
) -> None:
    """Parses the command line, runs the command, and prints bad input as one sentence."""
    parsed = tyro.cli(arguments, prog=f"python -m {program}")
    try:
        code = command(parsed)
    except JaxactError as error:
        print(f"{program}: {error}", file=sys.stderr)
        code = 2
    sys.exit(code)


def _use_compilation_cache() -> None:
    import jax
    import jaxlib

    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    path = cache / "jaxact" / f"jaxlib-{jaxlib.__version__}"
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def _train(arguments: TrainArguments) -> int:
    from jaxact.describe import describe
    from jaxact.loading import load_experiment, split_variant
    from jaxact.overrides import override
    from jaxact.runs import open_run, read_config
    from jaxact.train import Run

    name, seed, assignments = arguments.experiment, arguments.seed, arguments.set
    if arguments.resume is not None:
        config = read_config(open_run(arguments.resume))
        seed, assignments = config["seed"], tuple(config["overrides"]) + assignments
        name = name or str(arguments.resume / "source" / config["source"])
    if name is None:
        raise JaxactError("name an experiment to train, or a run to --resume")
    if arguments.compilation_cache:
        _use_compilation_cache()
    experiment, source = load_experiment(name)
    experiment = override(experiment, assignments)
    if arguments.dry_run:
        print(describe(experiment, arguments.devices))
        return 0
    options = Options(**{f.name: getattr(arguments, f.name) for f in fields(Options)})
    variant = split_variant(name)[1]
    # What `load_experiment` is to be given of the run's own copy.
    text = f"{source.name}:{variant}" if variant else source.name
    config = {"overrides": list(assignments), "source": text}
    result = Run(experiment, seed, options, source, config).run()
    print(f"run: {result.run}")
    return 0 if result.interrupted is None else 128 + result.interrupted


def _evaluate(arguments: EvaluateArguments) -> None:
    from jaxact.evaluate import evaluate_run, report_expert

    if arguments.expert:
        report_expert(arguments.run, arguments.set, arguments.episodes, arguments.seed)
    else:
        evaluate_run(
            arguments.run,
            overrides=arguments.set,
            checkpoint=arguments.checkpoint,
            episodes=arguments.episodes,
            seed=arguments.seed,
            greedy=arguments.greedy,
            video=arguments.video,
            features=arguments.features,
        )


def _collect(arguments: CollectArguments) -> int:
    from jaxact.collect import collect_named

    if arguments.expert and arguments.checkpoint is not None:
        raise JaxactError("--expert and --checkpoint exclude each other")
    if arguments.greedy and arguments.checkpoint is None:
        raise JaxactError("--greedy is for the policy of a --checkpoint")
    try:
        collect_named(
            arguments.name,
            arguments.output,
            arguments.episodes,
            overrides=arguments.set,
            checkpoint=arguments.checkpoint,
            greedy=arguments.greedy,
            seed=arguments.seed,
            successful_only=arguments.successful_only,
            final_observations=arguments.final_observations,
            progress=arguments.progress,
        )
    except KeyboardInterrupt:
        print(f"{arguments.output}: interrupted; the same command goes on with it")
        return 130
    return 0


def _plot(arguments: PlotArguments) -> None:
    from jaxact.plot import check_output, plot_runs
    from jaxact.runs import write_json

    output = check_output(arguments.output)
    plot = plot_runs(
        arguments.runs,
        metrics=arguments.metric,
        statistic=arguments.statistic,
        smooth=arguments.smooth,
        hours=arguments.hours,
        labels=arguments.label,
    )
    for note in plot.notes:
        print(f"jaxact.plot: {note}", file=sys.stderr)
    written = [*plot.save(output)]
    if arguments.table:
        print(plot.table())
        written.append(output.with_suffix(".json"))
        write_json(written[-1], plot.to_json())
    print("written:", *written)


def _sweep(arguments: SweepArguments) -> int:
    from jaxact.loading import load_experiment
    from jaxact.overrides import override
    from jaxact.search_space import SearchSpace
    from jaxact.sweep import Sweep
    from jaxact.sweep_records import read_sweep_config
    from jaxact.sweep_report import report

    def tell(sweeps: tuple[Path, ...]) -> None:
        print(report(sweeps, arguments.metric, arguments.smallest, arguments.figure))

    if arguments.report:
        tell(arguments.report)
        return 0
    name, draw, assignments = arguments.experiment, arguments.draw, arguments.set
    if arguments.resume is not None:
        config = read_sweep_config(arguments.resume)
        draw = draw or tuple(f"{paths}={text}" for paths, text in config["space"].items())
        if "source" in config:
            assignments = tuple(config["overrides"]) + assignments
            name = name or str(arguments.resume / "source" / config["source"])
    if name is None:
        raise JaxactError("name an experiment to search, or a sweep to --resume or to --report")
    experiment, source = load_experiment(name)
    experiment = override(experiment, assignments)
    options = SweepOptions(**{f.name: getattr(arguments, f.name) for f in fields(SweepOptions)})
    config = {"overrides": list(assignments), "source": source.name}
    sweep = Sweep(experiment, SearchSpace.parse(draw), options, source, config)
    try:
        sweep.run()
    except KeyboardInterrupt:
        if sweep.directory is not None:
            print(f"stopped; go on with --resume {sweep.directory}")
        return 128 + signal.SIGINT
    if sweep.directory is not None:
        tell((sweep.directory,))
        print(f"sweep: {sweep.directory}")
    return 0
