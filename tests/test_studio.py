"""Pictures in any thread, in forked processes, and what dropped environments give back.

What could abort or hang runs in a process of its own.
"""

import gc
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
import pyvista

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.rendering import Renderer, canvas, studio
from cloth_envs.scene import Scene
from cloth_envs.state import State

HEAD = """
import gc, os, signal, sys, threading, time
from concurrent.futures import ThreadPoolExecutor
import gymnasium as gym, numpy as np, cloth_envs, cloth_envs.folds
cloth_envs.folds.warn_coarse = lambda scene: None
def make(mode="rgb_array", scene="Flag"):
    env = gym.make(f"MiniCloth-{scene}-v0", disable_env_checker=True, render_mode=mode, resolution=(9, 9))
    env.reset(seed=0)
    return env
def forked(job):
    "The exit code of a forked process that does job."
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    signal.alarm(20)
    job()
    sys.exit(0)
"""
forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")


def run(code: str) -> str:
    """Standard output of ``code`` after ``HEAD``, in a process that ends well and says nothing else."""
    done = subprocess.run([sys.executable, "-c", HEAD + code], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def flat() -> tuple[Scene, State]:
    across, down = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9))
    positions = np.stack([across, 0.1 * np.sin(6 * across), 2 - down])[None].astype(np.float32)
    return Scene("Flat", Grid(9, 9, 1.0, 1.0), Material(), 0.04, tuple(range(0, 81, 9))), State.still(positions)


@pytest.mark.parametrize("first", ["main", "thread"])
def test_threads_draw_the_same_picture(first: str) -> None:
    run(f"""
env, depth, seen = make(), make("depth_array"), []
def draw():
    seen.append((env.render(), depth.render()))
def elsewhere(job):
    thread = threading.Thread(target=job); thread.start(); thread.join()
for job in (draw, lambda: elsewhere(draw))[::{1 if first == "main" else -1}]:
    job()
draw()
elsewhere(env.close)
elsewhere(draw)
for picture, far in seen:
    assert (picture == seen[0][0]).all() and (far == seen[0][1]).all()
assert seen[0][0].std() > 10
""")


def test_many_threads_draw_many_environments_at_once() -> None:
    run("""
scenes = ["Flag", "BallDrop", "Curtain"]
truth = [make(scene=name).render() for name in scenes]
def job(number):
    env = make(scene=scenes[number % 3])
    for _ in range(3):
        assert (env.render() == truth[number % 3]).all()
    if number % 2:
        env.close()
with ThreadPoolExecutor(4) as pool:
    list(pool.map(job, range(12)))
with ThreadPoolExecutor(1) as pool:  # made in a thread that has ended
    env = pool.submit(make).result()
assert (env.render() == truth[0]).all()
""")


def test_a_process_may_end_while_windows_live() -> None:
    run("""
kept = make()
thread = threading.Thread(target=kept.render); thread.start(); thread.join()
cycle = [make()]; cycle.append(cycle); cycle[0].render()
""")


def test_a_daemon_thread_that_draws_ends_with_the_process_without_a_word() -> None:
    run("""
env = make()
env.render()
def draw():
    while True:
        env.render()
threading.Thread(target=draw, daemon=True).start()
time.sleep(0.3)
""")


def test_a_collection_in_another_thread_closes() -> None:
    run("""
import weakref
env = make(); env.render(); env.me = env
gone = weakref.ref(env.unwrapped._renderer)
env = None
thread = threading.Thread(target=gc.collect); thread.start(); thread.join()
assert gone() is None
make().render()
""")


@forks
def test_a_child_of_a_process_that_draws_says_what_to_do() -> None:
    run("""
env = make(); env.render()
def draw():
    for each in (env, make()):
        try: each.render()
        except RuntimeError as error: assert '"spawn"' in str(error) and "forkserver" in str(error)
        else: sys.exit(3)
    env.close()
def drop():
    global env
    env.step(env.action_space.sample())
    env = None
    gc.collect()
assert [forked(job) for job in (draw, drop, lambda: None, lambda: os._exit(0))] == [0, 0, 0, 0]
assert env.render().std() > 10
""")


@forks
def test_a_child_draws_when_nothing_is_open() -> None:
    run("""
env = make()
def draw():
    np.save(sys.argv[1] if len(sys.argv) > 1 else os.devnull, env.render())
    assert env.render().std() > 10
assert forked(draw) == 0
env.render(); env.close()
assert forked(draw) == 0
thread = threading.Thread(target=env.render); thread.start(); thread.join(); env.close()
assert forked(draw) == 0
assert threading.active_count() == 1
""")


@forks
@pytest.mark.parametrize(
    "backend",
    [
        {"backend": "reference"},
        {"backend": "reference", "backend_kwargs": {"solver": "admm"}},
        {"backend": "reference", "backend_kwargs": {"solver": "implicit"}},
        {"backend": "miniature"},
        {"backend": "cnn"},
        {"backend": "cnn", "backend_kwargs": {"engine": "torch"}},
    ],
    ids=lambda given: " ".join([given["backend"], *given.get("backend_kwargs", {}).values()]),
)
def test_a_child_steps_as_its_parent(backend: dict[str, object]) -> None:
    run(f"""
given = {backend | {"resolution": (9, 13)}}
if "torch" in str(given):
    os.environ["OMP_WAIT_POLICY"] = "passive"  # or they spin, on a busy machine for long
    import torch
    torch.set_num_threads(2)
def ahead(env):
    env.reset(seed=0)
    env.action_space.seed(0)
    return env.step(env.action_space.sample())[0]
single = gym.make("MiniCloth-Flag-v0", disable_env_checker=True, **given)
many = gym.make_vec("MiniCloth-Flag-v0", num_envs=3, **given)
truth = ahead(single), ahead(many)
def step():
    assert (ahead(single) == truth[0]).all() and (ahead(many) == truth[1]).all()
assert forked(step) == 0
""")


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="reads Linux's /proc")
def test_dropped_environments_give_back_their_memory() -> None:
    grown = run("""
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
def cycle():
    env = make(); env.step(env.action_space.sample()); env.render()
for _ in range(6): cycle()
before = resident()
for _ in range(12): cycle()
print(resident() - before)
""")
    assert float(grown) < 10  # MB; each had kept 33


def test_the_thread_ends_when_nothing_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studio, "LINGER", 0.05)
    scene, state = flat()
    first, second = Renderer(scene, width=64, height=64), Renderer(scene, width=64, height=64)
    first.draw(state), second.draw(state)
    first.close()
    del second
    gc.collect()
    until = time.monotonic() + 20
    while any(thread.name == "minicloth-studio" for thread in threading.enumerate()):
        assert time.monotonic() < until
        time.sleep(0.02)
    assert not canvas._spare
    assert first.draw(state).std() > 10
    first.close()


def test_a_spare_window_leaves_no_trace() -> None:
    scene, state = flat()
    pictures = []
    for color, captions in (("fabric", None), ("strain", ["a caption"]), ("fabric", None)):
        renderer = Renderer(scene, width=96, height=96, color=color, captions=captions)
        pictures.append(renderer.draw(state))
        renderer.close()
    np.testing.assert_array_equal(pictures[0], pictures[2])
    assert (pictures[0] != pictures[1]).any()


def test_pyvista_close_all_spares_our_windows() -> None:
    scene, state = flat()
    renderer = Renderer(scene, width=64, height=64)
    picture = renderer.draw(state)
    pyvista.close_all()
    np.testing.assert_array_equal(renderer.draw(state), picture)
    renderer.close()


def test_an_error_frees_what_was_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, state = flat()
    renderer = Renderer(scene, width=64, height=64)

    def fail(_: object) -> None:
        raise MemoryError("full")

    with monkeypatch.context() as patch:
        patch.setattr(canvas.look, "smooth_edges", fail)
        with pytest.raises(MemoryError, match="full"):
            renderer.draw(state)
    assert not renderer._canvas.is_open
    assert renderer.draw(state).std() > 10
    renderer.close()


class Sheet:
    """A drawing that is open until it is closed."""

    is_open = True

    def close(self) -> None:
        self.is_open = False

    def abandon(self) -> None:
        raise AssertionError


def elsewhere(job: Callable[[], object]) -> BaseException | None:
    """What ``job`` raises in a thread called ``other``."""
    caught: list[BaseException] = []

    def do() -> None:
        try:
            job()
        except BaseException as error:
            caught.append(error)

    thread = threading.Thread(target=do, name="other")
    thread.start()
    thread.join()
    return caught[0] if caught else None


def test_on_macos_only_the_main_thread_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setattr(os, "register_at_fork", lambda **_: None)
    monkeypatch.setattr("atexit.register", lambda _: None)
    rests: list[str] = []
    place, sheet = studio.Studio(lambda: rests.append("rest")), Sheet()
    assert place.run(sheet, threading.current_thread) is threading.main_thread()
    error = elsewhere(lambda: place.run(sheet, lambda: None))
    assert isinstance(error, RuntimeError)
    assert "'other'" in str(error)
    assert elsewhere(lambda: place.close(sheet)) is None  # left for the main thread
    assert sheet.is_open
    assert not rests
    place.run(Sheet(), lambda: None)
    assert not sheet.is_open


def test_the_end_of_a_process_closes_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "register_at_fork", lambda **_: None)
    monkeypatch.setattr("atexit.register", lambda _: None)
    place, sheet = studio.Studio(lambda: None), Sheet()
    assert place.run(sheet, lambda: threading.current_thread().name) == "minicloth-studio"
    place._end()
    assert not sheet.is_open
    with pytest.raises(RuntimeError, match="ending"):
        place.run(sheet, lambda: None)
