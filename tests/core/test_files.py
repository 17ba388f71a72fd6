"""Lock files: one holder at a time, nothing left behind, and no links followed."""

from tacgen.core.errors import TacgenError
from tacgen.core.files import holder_of, locked
from tests.messages import refused


def test_a_lock_is_held_by_one_and_removed_at_the_end(tmp_path):
    path = tmp_path / "shard.lock"
    with locked(path) as first:
        assert first is True
        assert "process" in holder_of(path)
        with locked(path) as second:
            assert second is False
        assert path.is_file()
    assert not path.exists()
    assert holder_of(path) is None


def test_a_symbolic_link_is_refused_and_its_target_untouched(tmp_path):
    target, path = tmp_path / "target", tmp_path / "shard.lock"
    target.write_text("mine")
    path.symlink_to(target)
    with refused(TacgenError), locked(path):
        pass
    assert target.read_text() == "mine"
    assert holder_of(path) is None
