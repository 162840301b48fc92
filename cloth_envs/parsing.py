"""A parser of command lines that names the nearest option for one that it does not know."""

import argparse
from collections.abc import Sequence
from typing import Any, NoReturn

from cloth_envs.naming import unknown_name


class Parser(argparse.ArgumentParser):
    """``argparse.ArgumentParser`` whose answer to an unknown option is the nearest one."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._names: list[str] = []
        super().__init__(*args, **kwargs)

    def add_argument(self, *args: Any, **kwargs: Any) -> argparse.Action:
        action = super().add_argument(*args, **kwargs)
        self._names += [name for name in action.option_strings if name.startswith("--")]
        return action

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[argparse.Namespace, list[str]]:
        given, rest = super().parse_known_args(args, namespace)
        unknown = next((word.partition("=")[0] for word in rest if word.startswith("--")), None)
        if unknown is not None:
            self.error(str(unknown_name("option", unknown, self._names)))
        return given, rest

    def error(self, message: str) -> NoReturn:
        """Leave with the exit code 2 and one line; options are told by ``--help``."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")
