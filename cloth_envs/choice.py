"""Which physics each member of a batch has."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from cloth_envs.arguments import as_plain, per_member


@dataclass(frozen=True)
class Choice:
    """A backend's ``name`` and ``options``, and the ``members`` of a batch that it steps."""

    name: str
    options: Any
    members: list[int]

    @property
    def line(self) -> str:
        """The name and those options on which results depend, as text."""
        own = {name: value for name, value in self.options.items() if name != "threads"}
        return f"{self.name} {json.dumps(own, sort_keys=True, default=repr)}"

    @property
    def whose(self) -> str:
        """The members as text."""
        return f"member{'s' if len(self.members) > 1 else ''} {spans(self.members)}"


def choices(backend: object, backend_kwargs: object, count: int) -> list[Choice]:
    """What is chosen for ``count`` members, those of one name and equal options together.

    A list has one entry for each member, all else is for all of them.

    Raises:
        ValueError: a list of another length.
    """
    names, given = per_member("backend", backend, count), per_member("backend_kwargs", backend_kwargs, count)
    found: list[Choice] = []
    for i, (name, own) in enumerate(zip(names, given, strict=True)):
        options = as_plain({} if own is None else own)
        for choice in found:
            if _equal((name, options), (choice.name, choice.options)):
                choice.members.append(i)
                break
        else:
            found.append(Choice(name, options, [i]))
    return found


def as_lists(chosen: Sequence[Choice]) -> dict[str, list[Any]]:
    """``backend`` and ``backend_kwargs`` with an entry for every member."""
    by_member = sorted((i, choice.name, choice.options) for choice in chosen for i in choice.members)
    return {"backend": [name for _, name, _ in by_member], "backend_kwargs": [own for *_, own in by_member]}


def spans(members: Sequence[int]) -> str:
    """Members, which rise, as ``0-3,7``."""
    runs = [[i for _, i in run] for _, run in groupby(enumerate(members), lambda pair: pair[1] - pair[0])]
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)


def _equal(one: object, other: object) -> bool:
    """Whether they are equal; no, where they hold arrays or tensors that can't tell."""
    try:
        return bool(one == other)
    except (ValueError, RuntimeError):
        return False
