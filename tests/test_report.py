"""The report's page: its scenes, words, commands, and that it is closed."""

import base64
import hashlib
import json
import re
import shlex
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import mujoco
import numpy as np
import pytest
from glb_reader import Glb
from report_pages import EPISODES, REPLAYS, page, played

from manip.errors import UserError
from manip.evaluation.episodes import Episode
from manip.programs import report
from manip.programs.train import config_of
from manip.reports.commands import train_command
from manip.reports.funnel import describe, funnel
from manip.reports.line_chart import HEIGHT, WIDTH, Axis, Line, line_chart
from manip.reports.replays import chosen_episodes
from manip.reports.run_record import load_records
from manip.reports.training_charts import compared_charts
from manip.sim.triangles import Triangles, geom_triangles, primitive_triangles
from manip.training.run_logs import renamed


@pytest.fixture(scope="module")
def glb() -> Glb:
    return Glb.parse(played()[2].scene)


def test_bodies_are_where_the_engine_has_them(glb: Glb) -> None:
    _, record, replays = played()
    assert len(replays.timelines) == REPLAYS
    for line in replays.timelines:
        episode = record.episodes[line["number"]]
        recorded = record.recorder.recorded(episode)
        model, states = recorded.model(), recorded.poses
        data = mujoco.MjData(model)
        for step in (0, len(states) // 2, len(states) - 1):
            data.qpos[:] = states[step]
            mujoco.mj_kinematics(model, data)
            poses = glb.poses(str(episode.index), step)
            for body in range(1, model.nbody):
                pose = poses[model.body(body).name]
                assert np.abs(pose[:3, 3] - data.xpos[body]).max() < 2e-4
                assert np.abs(pose[:3, :3].ravel() - data.xmat[body]).max() < 1e-3
            goal = poses["goal"][:3, 3]
            assert np.abs(goal - data.site("goal").xpos).max() < 2e-4


def test_goals_of_episodes_differ(glb: Glb) -> None:
    first, second = (line["number"] for line in played()[2].timelines)
    places = [glb.poses(str(n), 0)["goal"][:3, 3] for n in (first, second)]
    assert np.abs(places[0] - places[1]).max() > 0.01


def test_the_scene_is_drawn_with_few_triangles(glb: Glb) -> None:
    parts = [p for mesh in glb.tree["meshes"] for p in mesh["primitives"]]
    triangles = sum(len(glb.array(p["indices"])) // 3 for p in parts)
    assert 10_000 < triangles < 60_000
    for part in parts:
        rows = len(glb.array(part["attributes"]["POSITION"]))
        assert glb.array(part["indices"]).max() < rows
        normals = glb.array(part["attributes"]["NORMAL"])
        assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 0.02


def volume(mesh: Triangles) -> float:
    """Inside the surface, positive if triangles are counterclockwise from outside."""
    a, b, c = np.moveaxis(mesh.positions[mesh.faces], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize(
    ("kind", "size", "expected"),
    [
        ("BOX", (0.1, 0.2, 0.3), 8 * 0.1 * 0.2 * 0.3),
        ("SPHERE", (0.1, 0, 0), 4 / 3 * np.pi * 0.1**3),
        ("CYLINDER", (0.1, 0.2, 0), np.pi * 0.1**2 * 0.4),
        ("CAPSULE", (0.1, 0.2, 0), np.pi * 0.1**2 * 0.4 + 4 / 3 * np.pi * 0.1**3),
        ("ELLIPSOID", (0.1, 0.2, 0.3), 4 / 3 * np.pi * 0.1 * 0.2 * 0.3),
    ],
)
def test_primitives_have_their_volume(kind: str, size: tuple, expected: float) -> None:
    mesh = primitive_triangles(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"), size)
    assert volume(mesh) == pytest.approx(expected, rel=0.04)
    corners = mesh.positions[mesh.faces]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((face * mesh.normals[mesh.faces].mean(1)).sum(1) >= -1e-12).all()


def test_thinned_meshes_keep_their_shape() -> None:
    model = played()[1].recorder.batch.scene.visual
    geom = int(
        np.argmax(model.mesh_facenum[model.geom_dataid] * (model.geom_type == 7))
    )
    mesh, number = geom_triangles(model, geom), int(model.geom_dataid[geom])
    start, count = model.mesh_vertadr[number], model.mesh_vertnum[number]
    points = model.mesh_vert[start : start + count]
    assert len(mesh.faces) < model.mesh_facenum[number] / 2
    assert np.abs(np.ptp(mesh.positions, axis=0) - np.ptp(points, axis=0)).max() < 0.02


class Tags(HTMLParser):
    """Collects tags, attributes that name addresses, and scripts."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=False)
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.policy = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list) -> None:
        given = dict(attributes)
        self.tags.append(tag)
        self.addresses += [v for k, v in attributes if k in ("src", "href")]
        if given.get("http-equiv") == "Content-Security-Policy":
            self.policy = given["content"]


HOSTILE = '</script><img src=x onerror="alert(1)">'


def test_the_page_holds_no_markup_of_others() -> None:
    record, episodes, replays = played()
    task = record.task
    names = {"milestone_names": (HOSTILE, *task.milestone_names[1:])}
    hostile = type("Hostile", (type(task),), names)()
    lines = [
        line | {"spans": {HOSTILE: [[0.0, 1.0]]}, "outcome": HOSTILE}
        for line in replays.timelines
    ]
    record = replace(record, path=Path(HOSTILE), task=hostile, note=HOSTILE)
    text = page((record, episodes, replace(replays, timelines=lines)))
    tags = Tags(text)
    assert tags.tags.count("script") == 4
    assert "img" not in tags.tags
    assert HOSTILE not in text


def test_the_page_loads_nothing() -> None:
    tags = Tags(page(played(), played(still=True)))
    assert all(address.startswith("#") for address in tags.addresses)
    assert "default-src 'none'" in tags.policy
    assert "http" not in tags.policy


def test_the_policy_names_the_page_s_scripts() -> None:
    text = page(played())
    policy = Tags(text).policy
    scripts = re.findall(r'<script type="module">(.*?)</script>', text, re.DOTALL)
    assert len(scripts) == 2
    for script in scripts:
        digest = hashlib.sha256(script.encode()).digest()
        assert f"'sha256-{base64.b64encode(digest).decode()}'" in policy


@pytest.mark.parametrize(
    "command",
    [
        "--task Lift --reward-weights grasp=0 --steps 12000 --seed 3",
        "--task Lift --algo ppo --robot Sawyer --agent.gamma 0.9 --no-save-buffer",
        "--task Reach --controller OSC_POSITION --agent.actor-hidden 32 --horizon 20",
        "--task Lift --algo bc --observe cameras --image-size 64",
    ],
)
def test_the_command_gives_the_same_options(command: str) -> None:
    config = config_of([*command.split(), "--out", "runs/a b"])
    words = shlex.split(train_command(config))
    assert words[:2] == ["manip", "train"]
    assert config_of(words[2:]) == config


def episode(index: int, *flags: bool) -> Episode:
    """With milestones near and lift, success_once as lift, and success_held."""
    near, lift, lasting = flags
    return Episode(
        index, 5, 1.0, lift, lasting, lasting, None, (near, lift), index=index
    )


EIGHT = [
    *(episode(i, False, False, False) for i in range(1)),
    *(episode(i, True, False, False) for i in range(1, 5)),
    *(episode(i, True, True, False) for i in range(5, 7)),
    episode(7, True, True, True),
]


def test_the_funnel_counts_and_names_the_largest_loss() -> None:
    stages = funnel(EIGHT, ("near", "lift"))
    counts = {stage.name: stage.reached for stage in stages}
    assert counts == {"near": 7, "lift": 3, "success_held": 1}
    words = describe(stages, 8, {"reach": 0.2, "lift": 0}, {"reach": 0.2, "lift": 0.5})
    assert words[0].startswith("1 of 8 episodes")
    assert "lost" not in words[1]
    assert "at lift: of 7 episodes that reach near, 3" in words[1]
    assert any("term lift had weight 0" in line for line in words)
    assert not any("reach had" in line for line in words)


def test_replays_are_shared_by_failures_and_successes() -> None:
    chosen = [[e.index for e in chosen_episodes(EIGHT, n)] for n in (0, 2, 4, 20)]
    assert chosen == [[], [0, 7], [0, 1, 2, 7], [*range(8)]]


def test_charts_stay_inside_their_frame() -> None:
    line = Line("<b>", [0, 5e3, 2e4], [-3.0, 12.0, 7.5])
    text = str(line_chart("title", [line], Axis("x", scale=1e-3), Axis("y")))
    assert "<b>" not in text
    for x, y in re.findall(
        r"([\d.-]+),([\d.-]+)", re.findall(r'points="(.*?)"', text)[0]
    ):
        assert 0 <= float(x) <= WIDTH
        assert 0 <= float(y) <= HEIGHT


def test_a_milestone_called_success_is_not_renamed() -> None:
    old = renamed({"env_steps": 1.0, "train/success": 0.5})
    assert old == {"env_steps": 1.0, "train/success_at_end": 0.5}
    new = {"env_steps": 1.0, "train/success": 0.5, "train/success_at_end": 0.2}
    assert renamed(new) == new


def test_the_page_lists_every_episode() -> None:
    text = page(played(), played(still=True))
    assert text.count('<tr class="solved') + text.count('<tr class="failed') == (
        2 * EPISODES
    )
    assert f"0 of {EPISODES} episodes end in success" in text


def test_stored_results_are_shown(tmp_path: Path) -> None:
    rate = {"success_held": {"rate": 0.5, "low": 0.25, "high": 0.75}}
    level = {"value": 2.0, "success": rate, "return_mean": 1.0}
    row = {"name": HOSTILE, "unit": "kg", "levels": [level, level]}
    results = {"env": "native", "episodes": 7, "nominal": level, "perturbed": [row]}
    (tmp_path / "robustness.json").write_text(json.dumps(results))
    (tmp_path / "eval.json").write_text(
        json.dumps({"env": "stock", "episodes": 9, "seed": 5, "success": rate})
    )
    record, *rest = played()
    text = page((replace(record, path=tmp_path), *rest))
    assert "in 9 stock episodes, seed 5" in text
    assert "50 % <small>(25–75)</small>" in text
    assert HOSTILE not in text
    (tmp_path / "eval.json").write_text("{}")
    with pytest.raises(UserError, match=r"eval.json holds no results .*manip evaluate"):
        page((replace(record, path=tmp_path), *rest))


def test_damaged_results_are_found_before_the_episodes_run(
    tmp_path: Path, monkeypatch
) -> None:
    played()[0].policy.save(tmp_path / "policy")
    (tmp_path / "robustness.json").write_text("{}")
    monkeypatch.setattr(report, "record_episodes", None)
    with pytest.raises(UserError, match=r"robustness.json holds no results"):
        report.make_report(report.Report((tmp_path,)), "manip")


def test_a_folder_of_runs_is_reported_run_by_run(tmp_path: Path) -> None:
    for seed in ("seed0", "seed1"):
        (tmp_path / seed).mkdir()
        (tmp_path / seed / "config.yaml").write_text("{}")
    with pytest.raises(UserError, match="seed0 holds no policy: the run has not been"):
        report.make_report(report.Report((tmp_path,)), "manip")


def test_names_tell_runs_apart(tmp_path: Path) -> None:
    runs = [tmp_path / algo / seed for algo in ("a2c", "ppo") for seed in ("s0", "s1")]
    for run in runs:
        played()[0].policy.save(run)
    names = [record.name for record in load_records(runs)]
    assert names == ["a2c/s0", "a2c/s1", "ppo/s0", "ppo/s1"]
    assert [record.name for record in load_records(runs[:2])] == ["s0", "s1"]


def test_light_evaluations_are_in_the_compared_curves() -> None:
    rows = [{"env_steps": 1e3, "curve/success_held": 0.25}]
    rows += [{"env_steps": 2e3, "eval/success_held": 0.5, "train/return": 3.0}]
    (success, *_) = compared_charts([replace(played()[0], rows=rows)])
    (points,) = re.findall(r'points="(.*?)"', success)
    assert len(points.split()) == 2
