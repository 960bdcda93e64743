from dataclasses import replace
import pytest
from test_image_runs import options, teacher_in
from training_runs import assert_equal_runs, new_trainer

@pytest.mark.parametrize("algo", ["bc", "sac"])
@pytest.mark.parametrize("looks", [0.0, 1.0])
@pytest.mark.parametrize("overlap", [True, False])
def test_threads(algo, looks, overlap, tmp_path):
    teacher_in(tmp_path / "teacher")
    more = {} if algo == "bc" else {"teacher": None, "agent": {"rollout_length": 4, "batch_size": 16, "buffer_size": 48, "actor_hidden": [16], "critic_hidden": [16], "image_channels": [4, 8], "image_features": 8, "image_shift": 1, "random_steps": 16}}
    runs = []
    for threads in (1, 2, 3):
        config = options(tmp_path, algo=algo, looks=looks, overlap=overlap, threads=threads, out=str(tmp_path / f"run{threads}"), **more)
        assert new_trainer(config).run()
        runs.append(config.folder)
    assert_equal_runs(runs[0], runs[1])
    assert_equal_runs(runs[0], runs[2])
