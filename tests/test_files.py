"""Files: trees come back as they were; damage is told, and never runs code."""

import json
import os
import pickle
import socket
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import torch
from bomb import Bomb, archived, bare
from safetensors import safe_open
from safetensors.torch import load_file
from sameness import assert_same

from manip.errors import DamagedError, UserError
from manip.io.atomic_files import remove_partial, replace_file, write_text
from manip.io.checksums import save_with_checksum
from manip.io.tensor_trees import load_tree, save_tree

TREE = {
    "tensors": {"a": torch.arange(6.0).reshape(2, 3), "b": torch.tensor(True)},
    "by number": {0: torch.ones(1), 17: {"exp_avg": torch.zeros(0, 4)}},
    "arrays": [np.arange(3), np.array(2.5), np.ones((2, 0), np.float32)],
    "lists": [[1, 2], [], [[torch.ones(2, dtype=torch.uint8)]]],
    "empty": {},
    "numbers": [0.1 + 0.2, 1 << 60, -float("inf"), True, None, "text"],
    "a/b": torch.zeros(1),
    "a": {"b": torch.ones(1)},
    "view": torch.arange(12.0).reshape(3, 4).T[1:],
}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "new" / "tree.safetensors"


def test_a_tree_comes_back_as_it_was(path: Path) -> None:
    save_tree(path, TREE)
    assert_same(load_tree(path), TREE)


def test_what_is_saved_shares_no_memory_and_is_not_changed(path: Path) -> None:
    shared = torch.zeros(4)
    save_tree(path, {"whole": shared, "part": shared[2:]})
    found = load_tree(path)
    found["whole"] += 1
    assert not found["part"].any()
    assert not shared.any()


@pytest.mark.parametrize("tree", [{1: 0, "1": 0}, {True: 0}, {(1, 2): 0}])
def test_keys_that_would_not_come_back_are_refused(tree, path: Path) -> None:
    with pytest.raises(TypeError, match="keys must be all text or all integers"):
        save_tree(path, tree)
    assert not path.exists()


def test_a_missing_file_is_named(path: Path) -> None:
    with pytest.raises(UserError, match=f"there is no file {path}"):
        load_tree(path)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.9, 0.9999])
def test_a_truncated_file_is_refused(path: Path, share: float) -> None:
    save_tree(path, TREE)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(UserError, match="is damaged or not a manip file"):
        load_tree(path)


def test_every_flipped_bit_is_refused(path: Path) -> None:
    save_tree(path, TREE)
    whole = path.read_bytes()
    for bit in range(0, 8 * len(whole), 41):
        path.write_bytes(flipped(whole, bit))
        with pytest.raises(DamagedError, match="is damaged or not a manip file"):
            load_tree(path)


def test_other_readers_of_safetensors_read_a_sealed_file(path: Path) -> None:
    save_tree(path, {"a": {"b": torch.arange(3)}, "c": 1})
    assert_same(load_file(path), {"a/b": torch.arange(3)})


def test_safetensors_reads_metadata_and_every_dtype(path: Path) -> None:
    tensors = {
        str(dtype): torch.ones(3, dtype=dtype)
        for dtype in (torch.float64, torch.bfloat16, torch.int16, torch.bool)
    }
    save_with_checksum(path, tensors | {"scalar": torch.tensor(2.0)}, {"b": "1"})
    assert_same(load_file(path), tensors | {"scalar": torch.tensor(2.0)})
    with safe_open(path, "pt") as file:
        assert file.metadata().keys() == {"b", "checksum"}


def test_the_same_values_give_the_same_bytes(tmp_path: Path) -> None:
    """However often, in whatever order: safetensors orders metadata at random."""
    tensors = {name: torch.full((3,), float(i)) for i, name in enumerate("cab")}
    metadata = {name: name for name in "zyxwv"}
    files = []
    for number, names in enumerate(("cab", "abc", "bca")):
        files.append(tmp_path / f"{number}.safetensors")
        ordered = {name: tensors[name] for name in names}
        save_with_checksum(files[-1], ordered, dict(sorted(metadata.items())))
        metadata = dict(reversed(metadata.items()))
    assert len({file.read_bytes() for file in files}) == 1


def test_a_tensor_that_a_tree_names_twice_is_refused(path: Path) -> None:
    """A small file could fill the memory with copies."""
    tree = json.dumps([{"$tensor": "a"}, {"$tensor": "a"}])
    save_with_checksum(path, {"a": torch.ones(3)}, {"tree": tree})
    with pytest.raises(DamagedError, match="is damaged or not a manip file"):
        load_tree(path)


def test_what_killed_writers_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    write_text(tmp_path / "a" / "kept.json", "kept")
    with pytest.raises(KeyboardInterrupt):
        replace_file(tmp_path / "a" / "new.json", killed)
    (tmp_path / "a" / ".folder.partial-1").mkdir()
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / ".file.partial-1").touch()
    remove_partial(tmp_path, "a", "missing")
    names = {path.name for path in (tmp_path / "a").iterdir()}
    assert names == {"kept.json", ".folder.partial-1"}
    assert [path.name for path in (tmp_path / "b").iterdir()] == [".file.partial-1"]


def killed(temporary: Path) -> None:
    """As if no `finally` came to run: what is removed then is there again."""
    temporary.write_text("ne")
    temporary.rename(temporary.with_suffix(".again"))
    raise KeyboardInterrupt


def flipped(whole: bytes, bit: int) -> bytes:
    damaged = bytearray(whole)
    damaged[bit // 8] ^= 1 << (bit % 8)
    return bytes(damaged)


def test_a_pickle_is_refused_and_not_run(path: Path, tmp_path: Path) -> None:
    mark = tmp_path / "exploded"
    pickle.loads(bare(Bomb(mark)))
    assert mark.exists()
    mark.unlink()
    path.parent.mkdir()
    for wrap in (bare, archived):
        path.write_bytes(wrap(Bomb(mark)))
        with pytest.raises(UserError, match="is damaged or not a manip file"):
            load_tree(path)
        assert not mark.exists()


def test_a_failed_write_leaves_the_old_file_and_nothing_else(path: Path) -> None:
    write_text(path, "old")

    def fails_half_way(temporary: Path) -> None:
        temporary.write_text("ne")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        replace_file(path, fails_half_way)
    with pytest.raises(TypeError, match="not JSON serializable"):
        save_tree(path, {"a": torch.ones(3), "b": object()})
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]


def test_a_write_is_whole_readable_by_all_and_leaves_nothing_else(path: Path) -> None:
    for text in ("first", "second"):
        write_text(path, text)
        assert path.read_text() == text
        assert path.stat().st_mode & 0o777 == 0o644
        assert list(path.parent.iterdir()) == [path]


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    target = tmp_path / "there" / "file.json"
    for text in ("new", "newer"):  # also where the link leads to no file yet
        link = tmp_path / "link.json"
        link.unlink(missing_ok=True)
        link.symlink_to(Path("there") / "file.json")
        write_text(link, text)
        assert link.is_symlink()
        assert target.read_text() == text
    assert [path.name for path in target.parent.iterdir()] == ["file.json"]


def test_a_file_with_two_names_is_not_changed_under_the_other(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    os.link(tmp_path / "a", tmp_path / "b")
    write_text(tmp_path / "a", "new")
    assert (tmp_path / "b").read_text() == "old"


def test_a_file_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "private"
    path.touch(0o600)
    write_text(path, "secret")
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_pipe_is_written_through(tmp_path: Path) -> None:
    path, received = tmp_path / "pipe", []
    os.mkfifo(path)
    reader = threading.Thread(target=lambda: received.append(path.read_text()))
    reader.start()
    write_text(path, "text")
    reader.join()
    assert received == ["text"]
    assert path.is_fifo()


def test_a_device_stays_a_device(tmp_path: Path) -> None:
    null = tmp_path / "null"
    null.symlink_to("/dev/null")
    for path in (Path("/dev/null"), null):
        write_text(path, "text")
        assert path.is_char_device()


@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"])
@pytest.mark.parametrize("redirected", [False, True])
def test_standard_output_is_written_through(name, redirected, tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; print('before', flush=True); "
    code += "from manip.io.atomic_files import write_text; "
    code += "write_text(Path(sys.argv[1]), 'text\\n'); print('after')"
    file = tmp_path / "output"
    with file.open("w") as output:
        done = subprocess.run(
            [sys.executable, "-c", code, name],
            stdout=output if redirected else subprocess.PIPE,
            text=True,
            check=True,
        )
    text = file.read_text() if redirected else done.stdout
    assert text == "before\ntext\nafter\n"


def test_folders_and_sockets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="it is a folder, not a file"):
        write_text(tmp_path, "text")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "s"))
        with pytest.raises(UserError, match="it is a socket, not a file"):
            write_text(tmp_path / "s", "text")
        assert (tmp_path / "s").is_socket()
