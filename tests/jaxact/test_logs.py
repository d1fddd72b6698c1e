import math
import struct
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from tensorboardX.proto.event_pb2 import Event

from jaxact.errors import JaxactError
from jaxact.logs import RunLog, read_metrics


def read_events(directory: Path) -> list[Any]:
    events = []
    for path in sorted(directory.glob("events.out.tfevents.*")):
        data = path.read_bytes()
        while data:  # length, its checksum, the event, its checksum
            (length,) = struct.unpack("<Q", data[:8])
            events.append(Event.FromString(data[12 : 12 + length]))
            data = data[16 + length :]
    return events


def test_scalars_go_to_both_files(tmp_path: Path) -> None:
    with RunLog(tmp_path) as log:
        log.scalars(128, {"train/success": jnp.float32(0.5), "loss/ppo": np.float64(-2), "n": 3})
        assert len(read_metrics(tmp_path)) == 1  # on disk before the log is closed
        log.scalars(256, {"train/success": math.nan, "loss/ppo": math.inf})
    text = (tmp_path / "metrics.jsonl").read_text().splitlines()
    assert text[0] == '{"step": 128, "train/success": 0.5, "loss/ppo": -2.0, "n": 3.0}'
    assert text[1] == '{"step": 256, "train/success": null, "loss/ppo": null}'
    assert math.isnan(read_metrics(tmp_path)[1]["train/success"])
    events = [event for event in read_events(tmp_path) if event.summary.value]
    assert [event.step for event in events] == [128, 256]
    assert {value.tag: value.simple_value for value in events[0].summary.value} == {
        "train/success": 0.5,
        "loss/ppo": -2.0,
        "n": 3.0,
    }


def test_pictures_and_text(tmp_path: Path) -> None:
    with RunLog(tmp_path) as log:
        log.video("episodes/first", 7, np.zeros((3, 8, 6, 3), np.uint8))
        log.image("figure", 8, np.zeros((8, 6, 3), np.uint8))
        log.text("config", 0, "**bold**")
    values = {v.tag: v for event in read_events(tmp_path) for v in event.summary.value}
    assert values["episodes/first"].image.encoded_image_string.startswith(b"GIF89a")
    assert (values["figure"].image.height, values["figure"].image.width) == (8, 6)
    assert values["figure"].image.encoded_image_string.startswith(b"\x89PNG")
    assert values["config/text_summary"].tensor.string_val[0] == b"**bold**"


def test_a_resumed_log_equals_an_unbroken_one(tmp_path: Path) -> None:
    def log_steps(log: RunLog, steps: range) -> None:
        for step in steps:
            log.scalars(step, {"x": step / 3, "y": math.nan})
        log.close()

    log_steps(RunLog(tmp_path / "whole"), range(10))
    log_steps(RunLog(tmp_path / "broken"), range(7))
    file = tmp_path / "broken" / "metrics.jsonl"
    with file.open("a") as metrics:
        metrics.write('{"step": 7, "x"')  # killed while it wrote
    assert len(read_metrics(tmp_path / "broken")) == 7
    log_steps(RunLog(tmp_path / "broken", resume_step=4), range(5, 10))
    assert file.read_bytes() == (tmp_path / "whole" / "metrics.jsonl").read_bytes()
    purged = [event.step for event in read_events(tmp_path / "broken") if event.session_log.status]
    assert purged == [5]


def test_an_opened_log_goes_on(tmp_path: Path) -> None:
    for step in (1, 2):
        with RunLog(tmp_path) as log:
            log.scalars(step, {"x": 0.0})
    assert [line["step"] for line in read_metrics(tmp_path)] == [1, 2]


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(JaxactError, match=r"has no metrics\.jsonl"):
        read_metrics(tmp_path)
    (tmp_path / "metrics.jsonl").write_text("{}\nnonsense\n")
    with pytest.raises(JaxactError, match="line 2 is not valid JSON"):
        read_metrics(tmp_path)
