"""Task classes that a method of another makes, such as a revision or a preset with options; they pickle as that."""

import copyreg
from abc import ABCMeta
from collections.abc import Mapping
from typing import Any


class TaskType(ABCMeta):
    """The type of task classes."""


def derived(task: TaskType, name: str, own: Mapping[str, Any], method: str, **options: Any) -> Any:
    """A class of this ``name`` with its ``own`` attributes over those of ``task``, which a ``method`` makes again."""
    own = {"__module__": task.__module__, "__doc__": task.__doc__, **own, "made": (task, method, options)}
    return TaskType(name, (task,), own)


def made(task: TaskType, method: str, options: Mapping[str, Any]) -> Any:
    """What ``method`` of ``task`` makes."""
    return getattr(task, method)(**options)


def _how(task: TaskType) -> Any:
    """What ``pickle`` keeps of a class: what makes it, or its name."""
    own = vars(task).get("made")
    return (made, own) if own else task.__qualname__


copyreg.pickle(TaskType, _how)
