"""TensorBoard and Weights & Biases get rows and the options of a run."""

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from manip.errors import UserError
from manip.training.run_logs import RunLog, read_numbers

OPTIONS = {"task": "Reach", "cameras": ["a", "b"], "agent": {"gamma": 0.9, "on": True}}
ROWS = [{"env_steps": 10, "a": 1.5}, {"env_steps": 20, "a": 2.5, "b/c": 3.0}]


def test_tensorboard_shows_rows_and_options(tmp_path: Path) -> None:
    for _ in range(2):  # the second time, the events are written anew
        with closing(RunLog(tmp_path, ROWS[:1], OPTIONS, None)) as log:
            log.write(ROWS[1])
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    scalars = {n: [(e.step, e.value) for e in events.Scalars(n)] for n in ("a", "b/c")}
    assert scalars == {"a": [(10, 1.5), (20, 2.5)], "b/c": [(20, 3.0)]}
    (text,) = events.Tensors("options/text_summary")
    assert b"gamma: 0.9" in text.tensor_proto.string_val[0]
    start = events.summary_metadata["_hparams_/session_start_info"]
    assert b"agent.gamma" in start.plugin_data.content
    assert read_numbers(tmp_path / "metrics.csv") == ROWS


class FakeWandb:
    """Stands for TorchRL's logger, whose library is an extra."""

    made: list["FakeWandb"]

    def __init__(self, name: str, project: str, save_dir: str) -> None:
        if project == "broken":
            raise RuntimeError("no network")
        self.logged: list[Any] = [name, project]
        self.made.append(self)

    def log_hparams(self, options: dict[str, Any]) -> None:
        self.logged.append(options)

    def log_metrics(self, row: dict[str, float], step: int) -> None:
        self.logged.append((step, row))


def test_weights_and_biases_gets_rows_and_options(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(FakeWandb, "made", [], raising=False)
    monkeypatch.setattr("torchrl.record.loggers.WandbLogger", FakeWandb)
    with closing(RunLog(tmp_path, ROWS[:1], OPTIONS, "mine")) as log:
        log.write(ROWS[1])
    (logger,) = FakeWandb.made
    assert logger.logged == [tmp_path.name, "mine", OPTIONS, (20, ROWS[1])]
    with pytest.raises(UserError, match="--wandb broken: no network"):
        RunLog(tmp_path, [], OPTIONS, "broken")


def test_columns_of_earlier_versions_get_their_names_of_today(tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    path.write_text("env_steps,train/success,eval/return\n10,0.5,\n")
    assert read_numbers(path) == [{"env_steps": 10, "train/success_at_end": 0.5}]
    path.write_text("env_steps,a\n10,x\n")
    with pytest.raises(UserError, match=r"metrics\.csv is damaged"):
        read_numbers(path)
