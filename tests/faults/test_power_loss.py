"""Power lost at any moment: what was not synced is gone, or comes back cut short."""

import os
from pathlib import Path

import pytest

from tacgen.dataset import DatasetFolder
from tests.dataset.conftest import collect_toy, make_sample, make_spec

from .conftest import digests


class Disk:
    """What a disk holds of a folder: content and names that were synced, no others.

    ``images`` are the folders as they may be found after each step: every file with the content
    that was synced (or half of the rest), under the names that were synced, or under all names,
    for a file system may write those earlier.
    """

    def __init__(self, root: Path, held: Path) -> None:
        self.root, self.held = root, held
        held.mkdir()
        self.content: dict[int, bytes] = {}
        self.names: dict[str, int] = {}
        self.images: list[dict[str, bytes]] = []
        self._fsync, self._replace = os.fsync, os.replace

    def fsync(self, descriptor: int) -> None:
        self._fsync(descriptor)
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        everything = self._all_names()
        if path.is_dir():
            self.names = {n: i for n, i in self.names.items() if (self.root / n).parent != path}
            self.names |= {n: i for n, i in everything.items() if (self.root / n).parent == path}
        else:
            self.content[path.stat().st_ino] = path.read_bytes()
        self._cut()

    def replace(self, old: Path, new: Path) -> None:
        self._replace(old, new)
        self._cut()

    def _cut(self) -> None:
        for names in (self.names, self._all_names()):
            self.images.append({name: self._kept(inode) for name, inode in names.items()})

    def _all_names(self) -> dict[str, int]:
        names = {}
        for path in self.root.rglob("*"):
            if path.is_file():
                names[str(path.relative_to(self.root))] = inode = path.stat().st_ino
                # A second name, so that the number is not given to another file later.
                if not (self.held / str(inode)).exists():
                    os.link(path, self.held / str(inode))
        return names

    def _kept(self, inode: int) -> bytes:
        if inode in self.content:
            return self.content[inode]
        now = (self.held / str(inode)).read_bytes()
        return now[: len(now) // 2]


@pytest.mark.slow
def test_whatever_was_not_synced_is_lost_and_the_dataset_is_right(tmp_path, monkeypatch):
    spec = make_spec(n_grasps=6, shard_size=3)
    right = digests(collect_toy(tmp_path / "right", spec).root)
    root = tmp_path / "out"
    disk = Disk(root, tmp_path / "held")
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", disk.fsync)
        patch.setattr(os, "replace", disk.replace)
        folder = collect_toy(root, spec)
        folder.merge()
        with folder.claim(1, redo=True) as mine:
            assert mine
            folder.write_shard(1, (make_sample(i, spec) for i in range(3, 6)), spec)
    images = list({str(sorted(image.items())): image for image in disk.images}.values())
    assert len(images) > 3
    finished = 0
    for number, image in enumerate(images):
        found = lay_out(tmp_path / f"image-{number}", image)
        finished += check_and_go_on(found, spec, right)
    assert finished


def lay_out(root: Path, image: dict[str, bytes]) -> DatasetFolder:
    root.mkdir()
    for name, content in image.items():
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_bytes(content)
    return DatasetFolder(root)


def check_and_go_on(folder, spec, right):
    """No shard that counts as done is wrong, and the next run makes the rest."""
    folder.prepare(spec)
    done = [shard for shard in range(spec.n_shards) if folder.is_done(shard)]
    made = digests(folder.root)
    for shard in done:
        name = folder.shard_path(shard).name
        assert made[name] == right[name]
    for shard in range(spec.n_shards):
        with folder.claim(shard) as mine:
            if mine:
                samples = (make_sample(i, spec) for i in spec.shard_range(shard))
                folder.write_shard(shard, samples, spec)
    assert len(folder.merge()) == spec.n_shards
    assert digests(folder.root) == right
    return len(done)
