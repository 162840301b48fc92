"""``self_contact``: which scenes list it, who models it, and where it is saved."""

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs.physics import solver
from cloth_envs.recording import RecordRollout, Rollout
from cloth_envs.recording.spec import spec_texts
from cloth_envs.registry import PRESETS
from cloth_envs.scene import SelfContact
from cloth_envs.world import World

SMALL = (9, 9)


FOLDING = ("Curtain", "Flag", "Hanging", "BallDrop", "Draping", "Hitting", "Skirt")


@pytest.mark.parametrize("name", cloth_envs.SCENES)
def test_scenes_that_fold_list_it(name: str) -> None:
    for on in (None, False, True):
        scene = World(name, self_contact=on).scene
        on = name in FOLDING if on is None else on
        assert scene.self_contact == (SelfContact() if on else None)
        modelled, missing = scene.describe().split("not modelled:")
        words = f"self-contact, layers {1e3 * scene.layer:.2g} mm apart, friction 0.3"
        assert (words in modelled, "self-contact" in missing) == ((True, False) if on else (False, True))
    for preset in (preset for preset, scenes in PRESETS.items() if name in scenes):
        assert World(name, preset=preset).scene.self_contact == (SelfContact() if preset == "chen2020" else None)


def test_the_distance_of_layers_is_what_kernels_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, fine = (World("Hanging", resolution=shape, self_contact=True).scene for shape in ((33, 33), (65, 129)))
    without = World("Hanging", self_contact=False).scene
    assert (scene.layer, fine.layer, without.layer) == (0.004, 1 / 128 / 4, 0)
    monkeypatch.setattr(solver.kernels, "Sheet", lambda **given: (given["self_thickness"], given["self_friction"]))
    assert solver.kernel_sheet(fine) == (fine.layer, 0.3)
    assert solver.kernel_sheet(without) == (0, 0)


def test_the_argument() -> None:
    for make in (gym.make, gym.make_vec):
        env = make("MiniCloth-Flag-v0", resolution=SMALL, self_contact=False)
        assert env.unwrapped.scene.self_contact is None
        env.close()
    assert World("Pressure", resolution=SMALL, self_contact=np.True_).scene.self_contact == SelfContact()
    assert World("Flag", preset="lee2019", backend_kwargs={"solver": "explicit"}, self_contact=True).scene.self_contact
    for wrong in (0, "yes", {"thickness": 0.01}):
        with pytest.raises(ValueError, match="self_contact must be True or False"):
            World("Flag", self_contact=wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"unknown keyword 'self_contac'.*'self_contact'"):
        gym.make("MiniCloth-Flag-v0", self_contac=False)
    with pytest.raises(ValueError, match=r"net of particles.*leave self_contact or preset out"):
        World("Hanging", preset="zhao2024", self_contact=True)


@pytest.mark.parametrize("chosen", sorted({*solver.SOLVERS} - {"explicit"}))
def test_solvers_without_it_say_so(chosen: str) -> None:
    for options in ({"solver": chosen}, {"solver": chosen, "factor": 2}):
        physics = {"backend": "miniature" if "factor" in options else "reference", "backend_kwargs": options}
        world = World("Hanging", resolution=SMALL, **physics)
        assert world.scene.self_contact is None
        assert "self-contact" in world.scene.describe().split("not modelled:")[1]
        with pytest.raises(ValueError, match=r"self_contact=True: .* use solver='explicit'"):
            World("Hanging", resolution=SMALL, self_contact=True, **physics)


@pytest.mark.parametrize(("factor", "layer"), [(2, 0.0078125), (4, 0.015625)])
def test_miniatures_have_it_in_the_coarse_cloth(factor: int, layer: float) -> None:
    world = World("Hanging", backend="miniature", backend_kwargs={"factor": factor})
    assert world.scene.self_contact == SelfContact()
    assert world.backend.coarse.scene.layer == pytest.approx(layer)  # type: ignore[attr-defined]
    off = World("Hanging", backend="miniature", backend_kwargs={"factor": factor}, self_contact=False)
    assert off.scene.self_contact is None
    assert off.backend.coarse.scene.self_contact is None  # type: ignore[attr-defined]


def test_states_say_which_they_are_of(tmp_path) -> None:
    worlds = {on: World("Flag", resolution=SMALL, self_contact=on) for on in (True, False)}
    for world in worlds.values():
        world.reset({0: np.random.default_rng(0)})
    with pytest.raises(ValueError, match=r"self_contact \{'thickness': 0\.004, 'friction': 0\.3\} instead of None"):
        worlds[False].set_state(worlds[True].get_state())
    for on in (True, False):
        path = str(tmp_path / f"{on}.h5")
        with RecordRollout(gym.make("MiniCloth-Flag-v0", resolution=SMALL, self_contact=on), path) as env:
            assert f'"self_contact": {str(on).lower()}' in spec_texts(env.env)["env_spec"]
            env.reset(seed=0)
            env.step(env.action_space.sample())
        with Rollout.open(path) as record:
            assert record.scene.self_contact == (SelfContact() if on else None)


@pytest.mark.parametrize(("scene", "speed"), [("Flag", 50.0), ("Hanging", 1000.0), ("BallDrop", 100.0)])
def test_cloth_that_blows_up_ends_by_failure_or_goes_on(scene: str, speed: float) -> None:
    for on in (False, True):
        env = gym.make(f"MiniCloth-{scene}-v0", resolution=(17, 25), self_contact=on).unwrapped
        env.reset(seed=1)
        wild = np.random.default_rng(1).normal(0, speed, env.positions.shape).astype(np.float32)
        env.set_positions(env.positions, wild)  # type: ignore[attr-defined]
        info = env.step(np.zeros(env.action_space.shape, np.float32))[4]  # type: ignore[arg-type]
        assert info.get("failure") is not None or np.isfinite(env.positions).all()
