"""TensorBoard events: the values that went in, read without TensorBoard, harmless to a run."""

from __future__ import annotations

import io
import math
import struct
import threading

import numpy as np
import pytest
from disk import full_disk
from PIL import Image
from tensorboardX.proto import event_pb2, plugin_hparams_pb2

from isas_cli.records import trackers
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError

CONFIG = """\
scene:
  name: pottery
  targets: [a.exr, b.exr]
optimizer:
  lr: 0.02
  mask_updates: true
budget:
  seconds: null
"""


def row(iteration: int, seconds: float, **more) -> dict:
    known = {"loss": 1 / (1 + iteration), "parameter_rmse/jar.bsdf.data": 0.25, "nonfinite": 0}
    return {"iteration": iteration, "seconds": seconds, "paths": 3 * 2**20, **known, **more}


def events(folder):
    """The events below a run's folder, file by file: the TFRecord framing taken off."""
    found = []
    for path in sorted((folder / "tensorboard").iterdir()):
        data, place, of_file = path.read_bytes(), 0, []
        while place < len(data):
            (length,) = struct.unpack_from("<Q", data, place)
            content = data[place + 12 : place + 12 + length]  # 8 of length, 4 of its checksum
            of_file.append(event_pb2.Event.FromString(content))
            place += 12 + length + 4
        assert place == len(data), f"{path} ends within an event"
        found.append(of_file)
    return found


def values(of_file, tag):
    """(step, time, Summary.Value) of the events under one tag."""
    return [
        (event.step, event.wall_time, value)
        for event in of_file
        for value in event.summary.value
        if value.tag == tag
    ]


def test_a_tracker_that_is_not_there_is_refused_in_one_line(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="did you mean 'tensorboard'.*none, tensorboard"):
        trackers.open("tensorbord", tmp_path, CONFIG)
    monkeypatch.setattr(trackers.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install .*'.\[tensorboard\]'"):
        trackers.check("tensorboard")
    trackers.check("none")
    assert not list(tmp_path.iterdir())


def test_no_tracker_writes_nothing(tmp_path):
    tracker = trackers.open("none", tmp_path, CONFIG)
    tracker.evaluation(row(0, 0.0))
    tracker.image("snapshot", np.zeros((2, 3, 3)), 0)
    tracker.close()
    assert not list(tmp_path.iterdir())


def test_scalars_stand_against_iterations_and_billed_seconds(tmp_path):
    threads = threading.active_count()
    tracker = trackers.open("tensorboard", tmp_path, CONFIG)
    assert threading.active_count() == threads, "would write within billed time"
    tracker.evaluation(row(0, 0.0, gradient_noise=math.nan, parameter_rmse=None))
    tracker.evaluation(row(40, 1.5, gradient_noise=0.125, parameter_rmse=0.5))
    (written,) = events(tmp_path)  # before close: TensorBoard looks on while the run goes on
    assert written[0].file_version == "brain.Event:2"
    loss = values(written, "loss")
    assert [step for step, _, _ in loss] == [0, 40]
    assert loss[1][1] - loss[0][1] == pytest.approx(1.5, abs=1e-6)
    assert [value.simple_value for _, _, value in loss] == pytest.approx([1.0, 1 / 41])
    paths = values(written, "paths")
    assert [value.simple_value for _, _, value in paths] == [3 * 2**20] * 2
    assert len(values(written, "parameter_rmse/jar.bsdf.data")) == 2
    for unknown_at_first in ("gradient_noise", "parameter_rmse"):
        assert [step for step, _, _ in values(written, unknown_at_first)] == [40]
    tracker.close()


def test_the_configuration_is_there_as_text_and_as_hyperparameters(tmp_path):
    trackers.open("tensorboard", tmp_path, CONFIG).close()
    (written,) = events(tmp_path)
    ((_, _, text),) = values(written, "config/text_summary")
    assert text.metadata.plugin_data.plugin_name == "text"
    shown = text.tensor.string_val[0].decode()
    assert [line[4:] for line in shown.splitlines()] == CONFIG.splitlines()
    ((_, _, session),) = values(written, "_hparams_/session_start_info")
    content = session.metadata.plugin_data.content
    settings = plugin_hparams_pb2.HParamsPluginData.FromString(content).session_start_info.hparams
    assert settings["scene.name"].string_value == "pottery"
    assert settings["optimizer.lr"].number_value == 0.02
    assert settings["optimizer.mask_updates"].bool_value is True
    assert settings["scene.targets"].string_value == "['a.exr', 'b.exr']"
    assert "budget.seconds" not in settings


def test_pictures_go_through_the_display_curve(tmp_path, rng):
    picture = rng.random((5, 7, 3)).astype(np.float32) * 4
    tracker = trackers.open("tensorboard", tmp_path, CONFIG)
    tracker.evaluation(row(12, 2.0))
    tracker.image("snapshot", picture, 12, exposure=0.5)
    tracker.close()
    (written,) = events(tmp_path)
    ((step, moment, value),) = values(written, "snapshot")
    assert step == 12 and moment == values(written, "loss")[0][1]
    decoded = np.asarray(Image.open(io.BytesIO(value.image.encoded_image_string)))
    assert np.array_equal(decoded, images.to_display(picture, 0.5))


def test_a_run_that_goes_on_appends_and_hides_what_it_writes_anew(tmp_path):
    first = trackers.open("tensorboard", tmp_path, CONFIG)
    for iteration in (0, 40, 80):
        first.evaluation(row(iteration, iteration / 10))
    # Killed after a checkpoint at iteration 50: never closed.
    second = trackers.open("tensorboard", tmp_path, CONFIG, purge_step=51)
    second.evaluation(row(60, 6.0))
    second.close()
    earlier, later = events(tmp_path)
    assert [step for step, _, _ in values(earlier, "loss")] == [0, 40, 80]
    (start,) = [event for event in later if event.HasField("session_log")]
    assert start.session_log.status == event_pb2.SessionLog.START and start.step == 51
    assert later.index(start) < min(i for i, event in enumerate(later) if event.HasField("summary"))
    ((_, moment, _),) = values(later, "loss")
    # Billed time goes on where it was, however long the run lay still; files name whole seconds.
    assert moment - values(earlier, "loss")[0][1] == pytest.approx(6.0, abs=1e-6)


def test_a_full_disk_silences_the_tracker_and_spares_the_run(tmp_path):
    said = []

    def warn(text: str) -> None:
        said.append(text)
        raise OSError("standard error is on that disk, too")

    tracker = trackers.open("tensorboard", tmp_path, CONFIG, warn=warn)
    with full_disk(4000):
        for iteration in range(50):
            tracker.evaluation(row(iteration, float(iteration)))
        tracker.image("snapshot", np.zeros((8, 8, 3)), 50)
        tracker.close()
    assert len(said) == 1 and "\n" not in said[0]
    assert "tracker=tensorboard" in said[0] and str(tmp_path / "tensorboard") in said[0]


def test_a_folder_that_cannot_be_made_silences_the_tracker(tmp_path, capsys):
    (tmp_path / "tensorboard").write_text("a file of that name")
    tracker = trackers.open("tensorboard", tmp_path, CONFIG)
    tracker.evaluation(row(0, 0.0))
    tracker.close()
    assert capsys.readouterr().err.count("warning: tracker=tensorboard") == 1
    assert (tmp_path / "tensorboard").read_text() == "a file of that name"
