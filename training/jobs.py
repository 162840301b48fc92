"""The same function over many items: in this process, in several, or on a Ray cluster."""

from collections.abc import Callable, Iterator, Sequence
from multiprocessing import get_context
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def each(
    job: Callable[[Item], Result], items: Sequence[Item], workers: int = 1, address: str | None = None
) -> Iterator[Result]:
    """What ``job`` makes of ``items``, as it comes, over ``workers`` processes or the Ray cluster at ``address``.

    Of a cluster, all machines need this checkout and the folders that ``job`` writes to.

    Raises:
        ImportError: an address, and no Ray.
    """
    if address is not None:
        yield from _on_ray(job, items, address)
    elif min(workers, len(items)) > 1:
        with get_context("spawn").Pool(workers) as pool:
            yield from pool.imap_unordered(job, items)
    else:
        yield from map(job, items)


def _on_ray(job: Callable[[Item], Result], items: Sequence[Item], address: str) -> Iterator[Result]:
    try:
        import ray
    except ImportError as error:
        raise ImportError("--ray needs Ray: pip install ray, or leave --ray out for processes here") from error
    ray.init(address=address, ignore_reinit_error=True)
    remote = ray.remote(num_cpus=1)(lambda item: job(item))  # it takes functions only
    waiting = [remote.remote(item) for item in items]
    while waiting:
        done, waiting = ray.wait(waiting)
        yield from ray.get(done)
