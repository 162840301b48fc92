"""A parser of command lines that says what to write instead of words that it does not know."""

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from cloth_envs.naming import unknown_name

# What other programs call it.
MEANT = {
    "--steps": "--frames",
    "--length": "--frames",
    "--physics": "--backend",
    "--grid": "--resolution",
    "--size": "--resolution",
    "--fabric": "--material",
    "--record": "--hdf5",
    "--h5": "--hdf5",
    "--mp4": "--video",
    "--movie": "--video",
    "--png": "--images",
    "--output": "--out",
    "--force": "--overwrite",
}


def whole(text: str) -> int:
    """A whole number. Raises ArgumentTypeError: ``text`` is none."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a whole number, got {text!r}") from None


def real(text: str) -> float:
    """A number. Raises ArgumentTypeError: ``text`` is none."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}") from None


class Parser(argparse.ArgumentParser):
    """``argparse.ArgumentParser`` that answers a mistake by what to write.

    Attributes:
        elsewhere: how an option that it does not have is written, by the option, its value and what else was given;
            None for those that it can't tell.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._names: list[str] = []
        self.elsewhere: Callable[[str, str | None, argparse.Namespace], str | None] | None = None
        super().__init__(*args, **kwargs)
        self.register("type", int, whole)
        self.register("type", float, real)

    def add_argument(self, *args: Any, **kwargs: Any) -> argparse.Action:
        action = super().add_argument(*args, **kwargs)
        self._names += [name for name in action.option_strings if name.startswith("--")]
        return action

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[argparse.Namespace, list[str]]:
        words = list(sys.argv[1:] if args is None else args)
        given, rest = super().parse_known_args(words, namespace)
        unknown = next((word for word in rest if word.startswith("--")), None)
        if unknown is not None:
            self.error(self._of_option(unknown, words, given))
        if rest:
            self.error(self._of_word(rest[0], words))
        return given, rest

    def _of_option(self, unknown: str, words: list[str], given: argparse.Namespace) -> str:
        option, equals, text = unknown.partition("=")
        after = words[words.index(unknown) + 1 :]
        value = text if equals else after[0] if after and not after[0].startswith("-") else None
        meant = MEANT.get(option)
        if meant not in self._names and self.elsewhere is not None:
            write = self.elsewhere(option, value, given)
            if write is not None:
                return f"unknown option {option!r}; write {write}"
        return str(unknown_name("option", option, self._names, meant=meant))

    def _of_word(self, unknown: str, words: list[str]) -> str:
        for option, rows, cols in zip(words, words[1:], words[2:], strict=False):
            if option.startswith("--resolution") and cols == unknown and (rows + cols).isdigit():
                return f"a resolution is one word: write {option} {rows}x{cols}"
        scene = next((name for name in self._names if name.startswith("--scene")), None)
        return f"{unknown!r} has no place here" + (f"; write {scene} {unknown}" if scene else ": leave it out")

    def error(self, message: str) -> NoReturn:
        """Leave with the exit code 2 and one line; options are told by ``--help``."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")
