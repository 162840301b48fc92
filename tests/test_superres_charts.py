"""What is shown beside Chen et al. 2020: how published networks converge."""

from pathlib import Path
from xml.etree import ElementTree

from training.bench.superres import chart
from training.superres.convergence import CONVERGENCE, FEATURES, convergence


def test_convergence_is_drawn_of_features_that_are_in_the_loss(tmp_path: Path) -> None:
    told = {
        name: {
            "steps": 20,
            "seconds": 4.0,
            "curve": [[step, *(30.0 + step for _ in range(count))] for step in (0, 10)],
            "recipe": {"weights": {"normal": weight, "velocity": weight, "kinematic": 0.0}},
        }
        for name, count, weight in (("all", 3, 0.1), ("d", 3, 0.0), ("mesh-sr", 1, 0.0))
    }
    rows = convergence("Draping", told)
    assert [(r.network, r.feature) for r in rows if r.weighed and r.step] == [
        *(("all", feature) for feature in FEATURES),
        ("d", "displacement"),
        ("mesh-sr", "displacement"),
    ]
    assert {(r.step, r.seconds) for r in rows} == {(0, 0.0), (10, 2.0)}
    chart.draw({CONVERGENCE: rows}, tmp_path, "")
    assert ElementTree.parse(tmp_path / f"{CONVERGENCE}.svg").getroot().tag.endswith("svg")
    assert (tmp_path / f"{CONVERGENCE}.png").stat().st_size > 10_000
