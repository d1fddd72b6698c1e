import pytest
from rich.console import Console

from jaxact.progress import ProgressDisplay

METRICS = {"train/success": 0.25, "train/return": 1.5, "losses/ppo": 0.125, "other": 9.0}


def test_plain_lines_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with ProgressDisplay(1000, interval=3600.0) as display:
        for steps in range(100, 1001, 100):
            display.update("ppo", steps, METRICS)
        display.message("saved [all] of it")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "compiling"
    assert len(lines) == 4  # the first update and the last one, whatever the interval
    assert lines[1].startswith("ppo  100/1,000 steps")
    assert "success 0.250  return 1.500  ppo 0.125" in lines[2]
    assert lines[2].startswith("ppo  1,000/1,000 steps")
    assert "steps/s  0:00 left" in lines[2]
    assert lines[3] == "saved [all] of it"
    assert "other" not in "".join(lines)


def test_interval(capsys: pytest.CaptureFixture[str]) -> None:
    with ProgressDisplay(1000, interval=0.0) as display:
        for steps in (100, 200, 300):
            display.update("ppo", steps, {})
    assert len(capsys.readouterr().out.splitlines()) == 4


def test_nothing_when_switched_off(capsys: pytest.CaptureFixture[str]) -> None:
    with ProgressDisplay(1000, enabled=False) as display:
        display.update("ppo", 100, METRICS)
        display.message("hidden")
    assert capsys.readouterr().out == ""


def test_live_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def terminal() -> Console:
        return Console(force_terminal=True, width=120)

    monkeypatch.setattr("jaxact.progress.Console", terminal)
    with ProgressDisplay(1000) as display:
        display.update("imitation", 500, METRICS)
        display.message("saved [all] of it")
    shown = capsys.readouterr().out
    for text in ("imitation", "50%", "500 / 1,000 steps", "success", "0.250", "saved [all] of it"):
        assert text in shown
