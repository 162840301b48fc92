"""How far a long command is: a bar on a terminal, plain lines in a file or a pipe. All on standard error."""

import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from time import monotonic
from typing import TypeVar

from tqdm import tqdm

Item = TypeVar("Item")
EVERY, SHARE = 10.0, 0.05  # s between two lines; in long runs this share of the time that has passed


def progress(
    items: Iterable[Item],
    label: str,
    total: int | None = None,
    *,
    unit: str = "",
    done: int = 0,
    name: Callable[[Item], str] | None = None,
) -> Iterator[Item]:
    """``items`` one after the other, telling how many are done.

    Args:
        items: what the loop is over.
        label: what is being done.
        total: how many there are in the end, with those ``done`` before; default their number.
        unit: what one of them is, such as ``"frame"``.
        done: how many were done by an earlier run.
        name: of an item, shown while it is worked on.
    """
    count = total if total is not None else len(items) if isinstance(items, Collection) else None
    if sys.stderr.isatty():
        bar = tqdm(items, label, count, initial=done, unit=unit or "it")
        for item in bar:
            if name is not None:
                bar.set_postfix_str(name(item))
            yield item
        return
    begin = told = monotonic()
    number = done
    for item in items:
        yield item
        number, now = number + 1, monotonic()
        if number != count and now - told >= max(EVERY, SHARE * (now - begin)):
            left = "" if count is None else f", about {_time((now - begin) / (number - done) * (count - number))} left"
            _tell(label, number, count, unit, f"{_time(now - begin)}{left}")
            told = now
    _tell(label, number, count, unit, _time(monotonic() - begin))


def announce(text: str) -> None:
    """Say on standard error what is going to be done, how much of it and where it goes, before it begins."""
    print(text, file=sys.stderr, flush=True)


def say(text: str) -> None:
    """Print a line on standard output, above the bar if there is one."""
    tqdm.write(text)


def _tell(label: str, number: int, count: int | None, unit: str, rest: str) -> None:
    many = f"{number}" if count is None else f"{number} of {count}"
    print(f"{label}: {many}{f' {unit}s' if unit else ''}, {rest}", file=sys.stderr, flush=True)


def _time(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {seconds} s" if minutes else f"{seconds} s"
