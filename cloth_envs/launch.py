"""Many operations of torch as one launch, which on a GPU costs as much as one operation."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

WARM_UP = 3  # runs before a recording, as torch's notes on CUDA graphs have it


class OneLaunch:
    """A function without arguments that reads tensors which stay where they are and gives new ones; no gradients.

    On a CUDA device it is recorded at its first call, as a CUDA graph, and replayed at all others: what it reads is
    then read where it lay at the first call.

    Args:
        function: without side effects, for it runs more than once at first; it waits for nothing of the device.
        device: of its tensors.
    """

    def __init__(self, function: Callable[[], Sequence[Tensor]], device: torch.device) -> None:
        self._function, self._device = function, device
        self._graph: torch.cuda.CUDAGraph | None = None
        self._results: Sequence[Tensor] = ()

    @torch.no_grad()
    def __call__(self) -> list[Any]:
        """What the function gives now, in new tensors."""
        if self._device.type != "cuda":
            return list(self._function())
        with torch.cuda.device(self._device):
            graph = self._graph or self._record()
            graph.replay()
            return [result.clone() for result in self._results]

    def _record(self) -> torch.cuda.CUDAGraph:
        aside = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        aside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(aside):
            for _ in range(WARM_UP):
                self._function()
        torch.cuda.current_stream().wait_stream(aside)
        graph = self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._results = self._function()
        return graph
