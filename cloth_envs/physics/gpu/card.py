"""How a frame gets onto a card, or is emulated where there is none."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.extras import missing
from cloth_envs.physics.gpu.terms import as_literal

if TYPE_CHECKING:
    import torch

MOST_THREADS, WARP, REGISTERS = 1024, 32, 65536  # of a block; of a multiprocessor
SMALL, LONGEST = 512, 16  # vertices of a sheet, of a thread
OPTIONS = ("--std=c++17", "-default-device", "--ftz=true", "--prec-div=false", "--prec-sqrt=false")
PRELUDE = "#define LANES card\n#define MINICLOTH_SCALAR\nnamespace std { using size_t = decltype(sizeof(0)); }\n"


class Runner(Protocol):
    """Steps a batch: ``run`` takes the addresses of what ``CardBatch`` of ``kernels/gpu/terms.hpp`` lists."""

    def run(self, fields: Sequence[int], members: int) -> None: ...


class Emulated:
    """What a card does, thread by thread on this processor. ``backwards``: the threads take turns from the last."""

    def __init__(self, sheet: np.ndarray, *, strip: int = 4, backwards: bool = False) -> None:
        self._sheet, self._strip, self._backwards = sheet.tobytes(), strip, backwards

    def run(self, fields: Sequence[int], members: int) -> None:
        kernels.emulate_card(self._sheet, list(fields), members, self._strip, self._backwards)


class Plan(NamedTuple):
    """Vertices of a thread, one below the other; threads of a block; blocks that share a multiprocessor."""

    strip: int
    threads: int
    blocks: int


def plan(rows: int, cols: int, memory: int, most_memory: int) -> Plan:
    """What was fastest of what was tried on an H200 with sheets of 9 x 13 to 65 x 65 vertices (docs/networks.md).

    As few vertices a thread as leave it 170 registers where one block's ``memory`` [bytes] is most of the
    ``most_memory`` that a multiprocessor's blocks share, or 128 where two fit; a vertex a thread of a small sheet.
    """

    def threads(strip: int) -> int:
        return -(-(-(-rows // strip) * cols) // WARP) * WARP

    strips = [s for s in range(1, rows + 1) if threads(s) <= MOST_THREADS] or [rows]
    if rows * cols <= SMALL:
        strip = min(strips, key=lambda s: (threads(s) * s / (rows * cols) + 0.05 * (s - 1), s))
        return Plan(
            strip, threads(strip), max(1, REGISTERS // ((72 if threads(strip) <= 128 else 96) * threads(strip)))
        )
    blocks, most = (2, 256) if 2 * memory <= most_memory else (1, 384)
    some = [s for s in strips if s <= LONGEST] or strips[:1]
    strip = next((s for s in some if threads(s) <= most), some[-1])
    return Plan(strip, threads(strip), blocks if threads(strip) <= most else 1)


class Kernel:
    """A kernel ``name`` of ``text``, compiled for ``device`` with ``macros``; blocks share ``memory`` [bytes].

    Raises:
        ImportError: CuPy is missing; names the extra.
    """

    def __init__(
        self, name: str, text: str, macros: Mapping[str, object], device: "torch.device", *, threads: int, memory: int
    ) -> None:
        self._device, self._threads, self._memory = device, threads, memory
        told = "".join(f"#define MINICLOTH_{key} {value}\n" for key, value in macros.items())
        self._kernel = _compiled(name, PRELUDE + told + text, device)
        with _cupy().cuda.Device(device.index):
            self._kernel.max_dynamic_shared_size_bytes = max(memory, self._kernel.max_dynamic_shared_size_bytes)

    def run(self, fields: Sequence[int], blocks: int) -> None:
        """Launch ``blocks`` of it after what torch's present stream holds; ``fields`` are its arguments."""
        import cupy
        import torch

        stream = torch.cuda.current_stream(self._device)
        with cupy.cuda.Device(self._device.index), cupy.cuda.ExternalStream(stream.cuda_stream, self._device.index):
            self._kernel((blocks,), (self._threads,), tuple(map(np.uint64, fields)), shared_mem=self._memory)


class Card:
    """The kernel of one sheet, compiled for ``device``. ``simple``: whether materials all are, none is, or None.

    Raises:
        ValueError: a sheet that does not fit into the memory that a block's threads share.
        ImportError: CuPy is missing; names the extra.
    """

    def __init__(self, sheet: np.ndarray, device: "torch.device", *, simple: bool | None = None) -> None:
        sheet, most = sheet.copy(), most_memory(device)
        rows, cols = int(sheet["rows"][0]), int(sheet["cols"][0])
        sheet["spare"] = kernels.card_memory(sheet.tobytes()) > most
        memory = kernels.card_memory(sheet.tobytes())
        if memory > most:
            raise ValueError(
                f"this sheet needs {memory} bytes of the memory that a block of threads shares, the card has {most}: "
                f"use a resolution of at most {rows * cols * most // memory} vertices, or device='cpu'"
            )
        self.plan = plan(rows, cols, memory, most)
        only = {True: "ONLY_SIMPLE", False: "ONLY_YIELDING", None: "ALL"}[simple]
        macros = {"STRIP": self.plan.strip, "THREADS": self.plan.threads, "BLOCKS": self.plan.blocks, only: ""}
        macros["SHEET"] = as_literal(sheet)
        self._compiled = Kernel(
            "minicloth_frame", kernels.card_text(), macros, device, threads=self.plan.threads, memory=memory
        )

    def run(self, fields: Sequence[int], members: int) -> None:
        self._compiled.run(fields, members)


def most_memory(device: "torch.device") -> int:
    """What a block's threads may share on a card [bytes]."""
    most: int = _cupy().cuda.Device(device.index).attributes["MaxSharedMemoryPerBlockOptin"]
    return most


@lru_cache(maxsize=64)
def _compiled(name: str, text: str, device: "torch.device") -> Any:
    cupy = _cupy()
    with cupy.cuda.Device(device.index):
        return cupy.RawModule(code=text, options=OPTIONS, backend="nvrtc").get_function(name)


def _cupy() -> Any:
    try:
        import cupy
    except ImportError as error:
        raise ImportError(missing("device='cuda'", error)) from error
    return cupy
