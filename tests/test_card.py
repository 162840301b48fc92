"""Where fits hold: what a miniature is made of within its card and beyond, and that it is told."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from cloth_envs import FABRICS, env_id
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.registry import PRESETS, SCENES
from cloth_envs.scene import Scene
from cloth_envs.scenes.flag import Flag
from cloth_envs.scenes.task import Episode
from cloth_envs.state import Controls
from cloth_envs.world import World
from surrogates.miniature.card import LAW, RANGES, numbers
from surrogates.miniature.choice import closure_card
from surrogates.miniature.coarse import coarse_grid
from training.bench.benchmark import MEASURED

RNG = np.random.default_rng(0)
BEYOND = {
    "another preset": ({"preset": "lee2019"}, "similar, bicubic: another scene than the one of its fit: "),
    "own compression": ({"material": {"compression": 0.5}}, "similar, bicubic: compression 0.5, fitted on 1"),
    "heavy": ({"material": {"areal_density": 2.5}}, "similar, bicubic: stretch by its own weight 12.5 times"),
    "twice the grid": ({"resolution": (65, 97)}, "similar, bicubic: 32 coarse cells down, fitted up to 19"),
    "few cells": ({"resolution": (9, 13)}, "closure, bilinear: 8 cells down, fitted on 32"),
    "oblong cells": ({"resolution": (17, 49)}, "closure, bilinear: cells 2 times longer than wide"),
    "few cells, heavy": ({"resolution": (9, 13), "material": {"areal_density": 2.5}}, "similar, bilinear: stretch by"),
}
WITHIN = {fabric: {"material": fabric} for fabric in FABRICS} | {
    "half the grid": {"resolution": (17, 25)},
    "twice the grid": {"resolution": (65, 97), "backend_kwargs": {"factor": 4}},
    "no self-contact": {"self_contact": False},
}


def world(**options: object) -> World:
    made = World("Flag", backend="miniature", **options)  # type: ignore[arg-type]
    made.reset({0: np.random.default_rng(0)})
    return made


@pytest.mark.parametrize("options", WITHIN.values(), ids=WITHIN)
def test_within_the_card_closure_and_network_are_taken(options: dict[str, object]) -> None:
    made = world(**options)
    assert (made.backend.scaling, made.backend.upscaler) == ("closure", "local")  # type: ignore[attr-defined]
    assert made.surrogate.tolist() == [""]


@pytest.mark.parametrize(("options", "why"), BEYOND.values(), ids=BEYOND)
def test_beyond_it_the_plainer_cloth_is_told(options: dict[str, object], why: str) -> None:
    made = world(**options)
    assert made.surrogate[0].startswith(why)
    assert made.surrogate[0] in made.describe()
    scaling, upscaler = why.split(":")[0].split(", ")
    assert (made.backend.scaling, made.backend.upscaler) == (scaling, upscaler)  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match=r"strict=True: .*leave strict out"):
        world(**options, backend_kwargs={"strict": True})


@pytest.mark.parametrize("scene", PRESETS["lee2019"])
def test_a_presets_cloth_is_never_that_of_a_fit(scene: str) -> None:
    made = World(scene, preset="lee2019", backend="miniature")
    made.reset({0: RNG})
    assert made.surrogate[0].startswith("similar, bicubic: ")


class Stormy(Flag):
    def controls(self, episode: Episode) -> Controls:
        controls = super().controls(episode)
        controls.wind = 3 * controls.wind
        return controls


class Light(Flag):
    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        return replace(super().build_scene(grid, material), gravity=1.62)


class Lower(Flag):
    def reward(self, episode: Episode) -> np.ndarray:
        return 0.5 * super().reward(episode)


@pytest.mark.parametrize("task", [Stormy, Light])
def test_a_task_of_ones_own_is_beyond_however_it_is_named(task: type[Flag], monkeypatch: pytest.MonkeyPatch) -> None:
    who = f"{task.__module__}:{task.__name__}"
    monkeypatch.setitem(SCENES, "Flag", who)
    for made in (world(), World(task, backend="miniature"), World("Flag", backend="auto")):
        made.reset({0: RNG})
        assert f"driven by {who}, another task than that of its fit" in made.surrogate[0]
        made.set_state(made.get_state())
    assert World("Flag", backend="auto").backend.inner.__class__.__name__ == "ExplicitSolver"  # type: ignore[attr-defined]


def test_a_task_that_only_rewards_differently_moves_the_cloth_of_the_fit() -> None:
    made = World(Lower, backend="miniature")
    made.reset({0: RNG})
    assert made.surrogate.tolist() == [""]


def test_materials_of_single_members_are_told_and_keep_their_own_springs() -> None:
    env = gym.make_vec(
        env_id("Flag"), num_envs=6, backend="miniature", randomize={"areal_density": (0.19, 2.0)}, resolution=(17, 25)
    )
    _, infos = env.reset(seed=0)
    made = env.unwrapped.world  # type: ignore[attr-defined]
    heavy = np.array([material.areal_density > 1.0 for material in made.materials])
    assert heavy.any()
    assert not heavy.all()
    assert [bool(why) for why in infos["surrogate"]] == heavy.tolist()
    assert infos["_surrogate"].tolist() == heavy.tolist()
    coarse = made.backend.coarse
    for material, plain in zip(made.materials, heavy, strict=True):
        assert (coarse.material(material) == material) == plain
    with pytest.raises(ValueError, match="strict"):
        World("Flag", backend="miniature", backend_kwargs={"strict": True}, randomize={"areal_density": (0.19, 4.0)})


def test_where_the_grid_is_plainer_members_beyond_the_card_are_told_by_their_own_springs() -> None:
    made = world(resolution=(9, 13), randomize={"areal_density": (2.4, 2.5)})
    assert made.backend.scaling == "closure"  # type: ignore[attr-defined]
    assert made.surrogate[0].startswith("similar, bilinear: ")
    assert made.backend.coarse.material(made.materials[0]) == made.materials[0]  # type: ignore[attr-defined]


def test_a_closure_that_is_asked_for_stays_and_is_told() -> None:
    made = world(preset="lee2019", backend_kwargs={"scaling": "closure", "upscaler": "bicubic"})
    assert made.backend.scaling == "closure"  # type: ignore[attr-defined]
    assert made.surrogate[0].startswith("closure, bicubic: another scene")


def test_a_larger_cloth_of_a_stiffer_material_counts_as_the_same() -> None:
    scene = World("Flag").scene
    same = numbers(scene, scene.material)
    assert same.keys() == RANGES.keys()
    twice = scene.grid.__class__(*scene.grid.shape, 2 * scene.grid.height, 2 * scene.grid.width)
    wide = scene.__class__(scene.name, twice, scene.material, scene.frame_dt)
    material = scene.material.with_changes(
        areal_density=0.4, stretch_stiffness=2000.0, shear_stiffness=600.0, bend_stiffness=3.2e-4,
        damping=5e-5 * np.sqrt(2),
    )  # fmt: skip
    found = numbers(wide, material)
    assert found == pytest.approx(same)


@pytest.mark.parametrize("scene", MEASURED)
@pytest.mark.parametrize("factor", [2, 3, 4])
def test_every_fitted_scene_has_a_card_of_its_own_cloth(scene: str, factor: int) -> None:
    card = closure_card(scene, factor)
    assert card is not None
    own = World(scene).scene
    assert card.scene == own
    coarse = coarse_grid(own.grid, factor)
    assert card.beyond(own, coarse) == card.grid_beyond(own.grid, coarse) == ""
    assert all(getattr(own.material, name) == 1 for name in LAW)
