"""The benchmarks by name."""

from __future__ import annotations

# name -> "module:main(argv)", imported on use.
BENCHMARKS: dict[str, str] = {
    "mesh": "training.bench.mesh:main",
    "peers": "training.bench.peers.run:main",
    "solvers": "training.bench.solvers:main",
    "speed-accuracy": "training.bench.speed_accuracy.run:main",
    "tables": "training.bench.papers.run:main",
    "stability": "training.bench.stability.run:main",
    "throughput": "training.bench.throughput.run:main",
    "transfer": "training.bench.transfer.run:main",
}
