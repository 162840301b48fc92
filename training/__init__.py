"""Data generation, training and benchmarks; nothing imports this but the command line."""

# `minicloth train NAME` -> "module:main(argv)", imported on use.
TRAININGS = {
    "dynamics": "training.dynamics.train:main",
    "local": "training.local.train:main",
    "mfsr": "training.superres.train:main",
    "mfsr-published": "training.superres.published:main",
    "physics-cnn": "training.cell.train:main",
    "upscaler": "training.upscaler.train:main",
}
