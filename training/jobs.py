"""The same function over many items: in this process, in several, or on a Ray cluster."""

from collections.abc import Callable, Iterator, Sequence
from multiprocessing import TimeoutError as NotYet
from multiprocessing import active_children, get_context
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
        ChildProcessError: a process was killed.
    """
    if address is not None:
        yield from _on_ray(job, items, address)
    elif min(workers, len(items)) > 1:
        yield from _in_processes(job, items, min(workers, len(items)))
    else:
        yield from map(job, items)


def _in_processes(job: Callable[[Item], Result], items: Sequence[Item], workers: int) -> Iterator[Result]:
    others = set(active_children())
    with get_context("spawn").Pool(workers) as pool:
        processes, results = set(active_children()) - others, pool.imap_unordered(job, items)
        waiting = len(items)
        while waiting:
            try:
                result = results.next(timeout=1.0)
            except NotYet:  # what a killed process worked on would be waited for without end
                if any(process.exitcode for process in processes):
                    raise ChildProcessError(
                        "a process was killed, for want of memory perhaps: run it again with fewer --jobs"
                    ) from None
            else:
                waiting -= 1
                yield result


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
