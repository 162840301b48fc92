"""Policies by name, function or file."""

import json
import re
import zipfile
from importlib import import_module
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
from gymnasium.spaces import Dict
from safetensors import SafetensorError
from safetensors.numpy import load_file

from cloth_envs.evaluation import Policy
from cloth_envs.extras import install
from cloth_envs.naming import resolve, unknown_name
from cloth_envs.observation import member
from cloth_envs.policies import CONTROLLERS
from cloth_envs.registry import load_task

NAMED = ("zero", "random", "controller")
LEARNED, NETWORKS = "ppo", Path(__file__).parent / "networks"  # those that ship, made by ``minicloth bench agents``
STAGES = "stages, shares of the time"  # of their cards


def load_policy(name: str, scene: str) -> Policy:
    """What takes observations of a batch to actions ``(B, A)``.

    ``name`` is ``"zero"``, ``"random"`` (drawn from one seed), ``"controller"`` (of ``cloth_envs.policies``), ``"ppo"``
    (a network that ships), ``"module:function"``, a ``.zip`` of Stable-Baselines3, a ``.safetensors`` of ``minicloth
    bench agents``, or a ``.pt`` file: one of ``examples/train_ppo.py``, or a module that torch scripted or traced.

    Raises:
        ValueError: no such policy, or a file that is none. ImportError: a package that it needs is missing.
    """
    actions = len(load_task(scene).actions)
    if name == "zero":
        return lambda seen: np.zeros((_count(seen), actions))
    if name == "random":
        rng = np.random.default_rng(0)
        return lambda seen: rng.uniform(-1, 1, (_count(seen), actions))
    if name == "controller":
        return CONTROLLERS[scene]
    if name == LEARNED:
        return _shipped(scene)
    suffix = Path(name).suffix
    if suffix in FILES:
        if not Path(name).is_file():
            raise ValueError(f"there is no file {name}")
        return FILES[suffix](name)
    if ":" in name:
        found = resolve(name)
        if not callable(found):
            raise ValueError(f"{name} is no function of observations")
        return found
    raise unknown_name("policy (or module:function, .zip, .pt, .safetensors):", name, (*NAMED, LEARNED))


def trained_on(name: str, scene: str) -> tuple[str, dict[str, Any]] | None:
    """The physics that a policy began on, backend and options, as its card tells; None: it has none, as others.

    Raises:
        ValueError: the file beside the network is no card of one.
    """
    path = NETWORKS / f"{scene}.safetensors" if name == LEARNED else Path(name)
    card = path.with_suffix(".json")
    if path.suffix != ".safetensors" or not card.is_file():
        return None
    try:
        backend, options, _ = json.loads(card.read_text())[STAGES][0]
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise ValueError(f"{card} is no card of a network, which tells {STAGES!r}: give --train-backend") from error
    return backend, options


def _shipped(scene: str) -> Policy:
    path = NETWORKS / f"{scene}.safetensors"
    if not path.is_file():
        there = ", ".join(sorted(path.stem for path in NETWORKS.glob("*.safetensors")))
        raise ValueError(f"no network ships for {scene}, there are {there}: examples/train_ppo.py trains one")
    return _of_safetensors(str(path))


def _of_safetensors(path: str) -> Policy:
    try:
        return _mlp_of(path, load_file(path))
    except SafetensorError as error:
        raise ValueError(f"{path} holds no tensors ({error}): minicloth bench agents --policies writes such") from error


def _count(seen: Any) -> int:
    return len(next(iter(seen.values())) if isinstance(seen, dict) else seen)


def _shape(seen: Any) -> Any:
    return {name: part.shape for name, part in seen.items()} if isinstance(seen, dict) else seen.shape


def _of_stable_baselines(path: str) -> Policy:
    try:
        import stable_baselines3
    except ImportError as error:
        raise ImportError(f"{path} needs Stable-Baselines3 ({error}): {install('rl')}") from error
    try:
        with zipfile.ZipFile(path) as archive:
            home = json.loads(archive.read("data"))["policy_class"]["__module__"]
    except (KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is no model of Stable-Baselines3 ({error})") from error
    if home.startswith("sb3_contrib"):  # some of which remember something from call to call
        raise ValueError(f"{path} is a model of sb3_contrib: load it there, and give its predict as module:function")
    kinds = {"sac": "SAC", "td3": "TD3", "dqn": "DQN"}
    algorithm = getattr(stable_baselines3, next((kinds[part] for part in home.split(".") if part in kinds), "PPO"))
    model = algorithm.load(path, device="cpu")
    space: Any = model.observation_space
    known = _shape(space.spaces if isinstance(space, Dict) else space)

    def act(seen: Any) -> np.ndarray:
        given = _shape(member(seen, 0))
        if given != known:
            raise ValueError(
                f"{path} reads observations of shape {known}, these have {given}: it was trained in another scene, or "
                "on others (--obs, --observe-material, --resolution)"
            )
        chosen: np.ndarray = model.predict(seen, deterministic=True)[0]
        return chosen

    return act


def _of_torch(path: str) -> Policy:
    try:
        torch = import_module("torch")
    except ImportError as error:
        raise ImportError(f"{path} needs torch ({error}): {install('train')}") from error
    try:
        with zipfile.ZipFile(path) as archive:
            scripted = any(name.endswith("constants.pkl") for name in archive.namelist())
    except zipfile.BadZipFile as error:
        raise ValueError(f"{path} is no file that torch saved ({error})") from error
    if scripted:
        module = torch.jit.load(path, map_location="cpu").float()

        def act(seen: Any) -> np.ndarray:
            tensors = torch.as_tensor
            given = {name: tensors(part) for name, part in seen.items()} if isinstance(seen, dict) else tensors(seen)
            try:
                chosen: np.ndarray = module(given).detach().numpy()
            except RuntimeError as error:
                what = str(error).splitlines()[0]  # values follow
                raise ValueError(f"{path} can't read observations of shape {_shape(seen)}: {what}") from error
            return chosen

        return act
    try:
        saved = torch.load(path, map_location="cpu", weights_only=True)
        weights = {name: value.detach().numpy() for name, value in saved.items()}
    except (AttributeError, UnpicklingError) as error:  # a whole module, or tensors in something else
        raise ValueError(
            f"{path} holds no tensors by name: save as examples/train_ppo.py does, or torch.jit"
        ) from error
    return _mlp_of(path, weights)


def _mlp_of(path: str, weights: dict[str, np.ndarray]) -> Policy:
    try:
        return mlp(weights)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def mlp(weights: dict[str, np.ndarray]) -> Policy:
    """A network with tanh between its layers on scaled observations, as ``examples/train_ppo.py`` saves it.

    ``weights`` are ``mean`` and ``spread`` ``(n,)``, and ``0.weight`` ``(m, n)``, ``0.bias`` ``(m,)`` and so on.

    Raises:
        ValueError: they lack something or don't fit each other; of the function, observations of another length.
    """
    layers = sorted({int(name.split(".")[0]) for name in weights if re.fullmatch(r"\d+\.weight", name)})
    needed = {"mean", "spread", *(f"{layer}.{part}" for layer in layers for part in ("weight", "bias"))}
    if not layers or weights.keys() != needed:
        raise ValueError("a policy's file holds mean, spread, 0.weight, 0.bias, ...; see examples/train_ppo.py")
    n = size = weights["mean"].size
    for layer in layers:
        rows = len(weights[f"{layer}.bias"])
        if weights[f"{layer}.weight"].shape != (rows, size):
            shape = weights[f"{layer}.weight"].shape
            raise ValueError(f"{layer}.weight of a policy's file must have shape {(rows, size)}, it has {shape}")
        size = rows
    if weights["mean"].shape != (n,) or weights["spread"].shape != (n,) or not (weights["spread"] > 0).all():
        raise ValueError("mean and spread of a policy's file must have one shape (n,), and spread be positive")

    def act(seen: np.ndarray) -> np.ndarray:
        if isinstance(seen, dict) or seen.shape[-1] != n:
            raise ValueError(
                f"this policy reads observations of {n} numbers: it was trained in another scene or on others"
            )
        x = np.clip((seen - weights["mean"]) / weights["spread"], -10, 10)
        for layer in layers:
            x = x @ weights[f"{layer}.weight"].T + weights[f"{layer}.bias"]
            x = np.tanh(x) if layer != layers[-1] else x
        return np.clip(x, -1, 1)

    return act


FILES = {".zip": _of_stable_baselines, ".pt": _of_torch, ".safetensors": _of_safetensors}
