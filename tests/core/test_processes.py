"""The supervisor: nothing is lost when a worker dies, hangs or fails."""

import contextlib
import os
import pickle
import signal
import struct
import subprocess
import sys
import time
from collections import deque
from multiprocessing import Pipe, Process
from pathlib import Path

import cv2
import numba
import pytest

from tacgen.core import processes
from tacgen.core.errors import TacgenError
from tacgen.core.processes import map_in_processes, run_tasks
from tests.messages import refused

ITEMS_PER_TASK = 4


class Script:
    """A job whose items misbehave as told, once or always."""

    def __init__(self, folder: Path, acts: dict[int | str, str]) -> None:
        self.folder, self.acts = folder, acts

    @contextlib.contextmanager
    def __call__(self):
        yield self.job

    def job(self, task, crashed, report):
        done = []
        for item in range(task * ITEMS_PER_TASK, (task + 1) * ITEMS_PER_TASK):
            if item in crashed:
                continue
            report("start", item, None)
            self.act(self.acts.get(item, ""), item)
            report("item", item, os.getpid())
            self.act(self.acts.get(f"after {item}", ""), f"after {item}")
            done.append(item)
        return done

    def act(self, what, item):
        marker = self.folder / f"{item}.seen"
        first = not marker.exists()
        marker.touch()
        if what == "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        elif what == "killed_once" and first:
            os.kill(os.getpid(), signal.SIGKILL)
        elif what == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        elif what == "hang" or (what == "hang_once" and first):
            time.sleep(60)
        elif what == "brief":
            time.sleep(0.01)
        elif what == "long":
            time.sleep(3.0)
        elif what == "slow":
            time.sleep(0.5)
        elif what == "wrong_input":
            raise TacgenError("item 5 is wrong; fix it")
        elif what == "bug":
            raise ZeroDivisionError


def results(folder, acts, n_tasks=3, workers=2, limit_s=20.0):
    events = list(
        run_tasks(range(n_tasks), Script(folder, acts), workers=workers, item_limit_s=limit_s)
    )
    done = {event.task: event.value for event in events if event.kind == "done"}
    return done, events


def items_of(task):
    return list(range(task * ITEMS_PER_TASK, (task + 1) * ITEMS_PER_TASK))


def test_every_task_is_done_once(tmp_path):
    done, _ = results(tmp_path, {})
    assert done == {task: items_of(task) for task in range(3)}


def test_an_item_that_takes_its_process_down_is_left_out(tmp_path):
    done, events = results(tmp_path, {5: "segfault"})
    assert done == {0: items_of(0), 1: [4, 6, 7], 2: items_of(2)}
    assert [event.value for event in events if event.kind == "crashed"] == [
        "the simulator died of SIGSEGV"
    ]


def burn(seconds):
    end_s = time.process_time() + seconds
    while time.process_time() < end_s:
        pass


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="the kernel does not count")
def test_waiting_for_a_core_is_no_time_of_a_process():
    """Four that share a core wait for three quarters of the time."""
    core = min(os.sched_getaffinity(0))
    crowd = [Process(target=burn, args=(60.0,)) for _ in range(4)]
    for one in crowd:
        one.start()
        os.sched_setaffinity(one.pid, {core})
    try:
        began_s, before_s = time.monotonic(), processes.waited_for_a_core_s(crowd[0].pid)
        time.sleep(2.0)
        share = (processes.waited_for_a_core_s(crowd[0].pid) - before_s) / (
            time.monotonic() - began_s
        )
        assert 0.6 < share < 1.0  # and longer where others want that core too
    finally:
        for one in crowd:
            one.kill()
            one.join()


def test_an_item_that_hangs_is_left_out(tmp_path):
    done, events = results(tmp_path, {6: "hang"}, limit_s=3.0)
    assert done[1] == [4, 5, 7]
    assert [event.item for event in events if event.kind == "crashed"] == [6]


def test_a_worker_killed_from_outside_costs_nothing(tmp_path):
    done, events = results(tmp_path, {5: "killed_once"})
    assert done == {task: items_of(task) for task in range(3)}
    assert [event.task for event in events if event.kind == "retried"] == [1]


def test_a_worker_that_falls_silent_between_items_is_replaced_and_nothing_is_lost(
    tmp_path, monkeypatch
):
    """Stopped by a hand, or held by a file system: no grasp's fault."""
    monkeypatch.setattr(processes, "SILENCE_LIMIT_S", 3.0)
    done, events = results(tmp_path, {"after 5": "hang_once"}, workers=1, limit_s=3.0)
    assert done == {task: items_of(task) for task in range(3)}
    assert [event.kind for event in events if event.kind not in ("item", "done")] == ["retried"]


def test_a_task_whose_worker_is_always_killed_stops_the_run_with_the_cause(tmp_path):
    with refused(TacgenError):
        results(tmp_path, {5: "killed"}, workers=1)


@pytest.mark.parametrize("items", [(4, 5, 6), (6, 7, 8)])
def test_three_crashes_in_a_row_stop_the_run_with_the_cause(tmp_path, items):
    """Of one task, or of two that follow each other."""
    with refused(TacgenError):
        results(tmp_path, dict.fromkeys(items, "segfault"))


def test_wrong_input_ends_the_run_with_its_own_words(tmp_path):
    with refused(TacgenError):
        results(tmp_path, {5: "wrong_input"})


def test_a_bug_is_not_hidden(tmp_path):
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):  # with a traceback
        results(tmp_path, {5: "bug"})


def wrong(item):
    raise TacgenError(f"item {item} is wrong; fix it")


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_an_error_in_a_mapped_process_keeps_its_words(method):
    with refused(TacgenError):
        map_in_processes(wrong, [4, 5], 2, method=method)


def handlers(_item):
    return signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)


def test_mapped_processes_do_not_handle_signals_as_the_command_line_does():
    """One that took SIGTERM for an error could keep the lock that the others wait for."""
    before = signal.signal(signal.SIGTERM, lambda *_: None)
    try:
        found = map_in_processes(handlers, [0, 1], 2)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert found == [(signal.SIG_DFL, signal.SIG_IGN)] * 2


def test_leaving_early_ends_every_process(tmp_path):
    events = run_tasks(range(3), Script(tmp_path, {}), workers=1, item_limit_s=20.0)
    pid = next(event.value for event in events if event.kind == "item")
    events.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


class Surroundings:
    """A job that tells what its process was given."""

    @contextlib.contextmanager
    def __call__(self):
        yield lambda _task, _crashed, _report: (
            os.environ["OMP_NUM_THREADS"],
            os.environ.get("TACGEN_TOLD"),
            cv2.getNumThreads(),
            numba.get_num_threads(),
        )


def test_a_worker_has_todays_environment_and_one_thread_a_library(tmp_path, monkeypatch):
    """Though the process that it is a copy of started earlier, and this one may use four."""
    results(tmp_path, {})
    monkeypatch.setenv("OMP_NUM_THREADS", "4")
    monkeypatch.setenv("TACGEN_TOLD", "now")
    events = list(run_tasks(range(1), Surroundings(), workers=1, item_limit_s=20.0))
    assert [event.value for event in events] == [("1", "now", 1, 1)]
    assert os.environ["OMP_NUM_THREADS"] == "4"


def test_workers_that_cannot_start_are_told_of(tmp_path, monkeypatch):
    """The process that they are copied from dies at once, whenever it is started."""

    def dies(*_):
        raise ConnectionRefusedError(111, "Connection refused")

    monkeypatch.setattr("multiprocessing.context.ForkServerProcess.start", dies)
    monkeypatch.setattr("tacgen.core.processes._START_PAUSE_S", 0.0)
    with refused(TacgenError):
        results(tmp_path, {})


def test_a_temporary_folder_too_long_for_a_socket_is_named(tmp_path, monkeypatch):
    folder = str(tmp_path / ("long" * 25))
    monkeypatch.setattr(processes, "get_temp_dir", lambda: folder)
    with refused(TacgenError):
        results(tmp_path, {})


def test_a_worker_that_is_killed_within_a_message_is_only_dead():
    ours, theirs = Pipe()
    worker = processes._Worker(Process(), ours, task=0)
    message = pickle.dumps(("item", 3, b"x" * 50_000))
    os.write(theirs.fileno(), struct.pack("!i", len(message)) + message[:1000])
    theirs.close()
    assert list(processes._read_messages(worker, processes._Progress(deque()))) == []


def test_copies_of_this_process_wait_for_no_thread_of_opencv():
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        assert map_in_processes(lambda _: cv2.getNumThreads(), [0, 1], 2) == [1, 1]
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)


def wait_long(number: int) -> int:
    time.sleep(600)
    return number


class Heavy:
    """A task that is longer than a pipe holds."""

    def __init__(self) -> None:
        self.data = bytes(1_000_000)

    def __call__(self, number: int) -> int:
        return wait_long(number)


MAPS = """
import sys
from tacgen.core.processes import map_in_processes
from tests.core.test_processes import Heavy
if __name__ == "__main__":
    try:
        map_in_processes(Heavy(), [0, 1], 2, method=sys.argv[1])
    except Exception as error:
        print(type(error).__name__, error)
"""


def children_of(pid: int, method: str) -> list[int]:
    """The mapped processes, not the one that removes semaphores."""
    found = []
    for child in map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split()):
        time.sleep(0.01)  # a copy still has its parent's name
        with contextlib.suppress(OSError):
            name = Path(f"/proc/{child}/cmdline").read_bytes()
            wanted = b"spawn_main" in name if method == "spawn" else b"maps.py" in name
            found += [child] if wanted else []
    return found


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_mapped_process_killed_as_it_starts_ends_the_command(method, tmp_path):
    (tmp_path / "maps.py").write_text(MAPS)
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "maps.py"), method],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])},
        stdout=subprocess.PIPE,
        text=True,
    ) as run:
        while not (found := children_of(run.pid, method)):
            assert run.poll() is None
            time.sleep(0.002)
        os.kill(found[0], signal.SIGKILL)
        said, _ = run.communicate(timeout=30)
    assert "a worker process was killed" in said


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_mapped_processes_end_with_a_killed_command(method, tmp_path):
    (tmp_path / "maps.py").write_text(MAPS)
    run = subprocess.Popen(
        [sys.executable, str(tmp_path / "maps.py"), method],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])},
    )
    while len(found := children_of(run.pid, method)) < 2:
        assert run.poll() is None
        time.sleep(0.01)
    time.sleep(3.0)  # they import numpy and begin
    run.kill()
    run.wait()
    deadline = time.monotonic() + 5
    while any(Path(f"/proc/{child}/cmdline").exists() for child in found):
        assert time.monotonic() < deadline, "orphans"
        time.sleep(0.05)


def test_a_worker_whose_orders_were_cut_off_says_nothing():
    program = (
        "import tacgen.core.end_quietly, pickle, sys\n"
        "cut = pickle.UnpicklingError('pickle data was truncated')\n"
        "for error in (cut, EOFError(), pickle.UnpicklingError('no such class')):\n"
        "    sys.excepthook(type(error), error, None)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ended.stderr == "_pickle.UnpicklingError: no such class\n"
