"""``minicloth evaluate``: a policy on the physics that it was trained on, and on the one that counts; one page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cloth_envs.agents import LEARNED, NAMED, load_policy
from cloth_envs.evaluation import Interval, Played, Verdict, play
from cloth_envs.files import check_file, write_bytes
from cloth_envs.registry import EPISODE_FRAMES, load_task

OWN = {"obs": "keypoints", "observe_material": False}  # what policies that have a name observe
Physics = tuple[str, Mapping[str, Any]]


def evaluate(
    policy: str, scene: str, *, train: Physics, certify: Physics, seeds: int, first_seed: int, beside: str,
    out: str | None, **options: Any,
) -> str:  # fmt: skip
    """The page as Markdown, which is also written to ``out``; ``beside`` are other policies, by commas.

    ``options`` are those of the world that both have: ``obs``, ``material``, ``randomize`` and so on. Policies by name,
    such as the controller, observe keypoints whatever others do.

    Raises:
        ValueError, ImportError, OSError: a bad name or number, a package that is missing, a file that can't be written.
    """
    load_task(scene)
    if out is not None:
        check_file(out, suffixes=(".md",))
    chosen = range(first_seed, first_seed + seeds)
    names = list(dict.fromkeys([policy, *filter(None, (name.strip() for name in beside.split(",")))]))
    policies = {
        name: [load_policy(name, scene) for _ in range(2)] for name in names
    }  # a random one draws alike on both
    verdicts = {}
    for name, both in policies.items():
        known = name in (*NAMED, LEARNED)
        played = [
            play(scene, act, chosen, backend=backend, backend_kwargs=dict(given), **options | (OWN if known else {}))
            for act, (backend, given) in zip(both, (train, certify), strict=True)
        ]
        verdicts[name] = Verdict(*played)
    frames, own = options.pop("frames", None), {n: value for n, value in options.items() if value != OWN.get(n)}
    text = page(policy, scene, verdicts, [_line(*train), _line(*certify)], chosen, frames, _line("", own).strip())
    if out is not None:
        write_bytes(Path(out), text.encode())
    return text + (f"\nwrote {out}" if out else "")


def _line(backend: str, options: Mapping[str, Any]) -> str:
    return " ".join([backend, *(f"{name}={value}" for name, value in options.items())])


def page(
    policy: str, scene: str, verdicts: Mapping[str, Verdict], physics: list[str], seeds: range, frames: int | None,
    options: str = "",
) -> str:  # fmt: skip
    """Tables of what was earned, of gaps and of failures, and what to beware of; ``options`` are those of both."""
    verdict, own, true = verdicts[policy], *physics
    others = {name: other for name, other in verdicts.items() if name != policy}
    lines = [
        f"# {policy} in {scene}",
        "",
        f"Trained on {own}, certified on {true}: seeds {seeds[0]} to {seeds[-1]} on both, episodes of "
        f"{frames or EPISODE_FRAMES[scene]} frames. Means over seeds, ± half of a 95 % interval; failed: in brackets "
        f"what their share is surely below (95 %).{f' Both with {options}.' if options else ''}",
        "",
        "| policy | physics | reward a frame | last second | success at end | failed | change of action | at a bound |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, each in verdicts.items():
        lines += [_row(name, own, each.own), _row(name, true, each.true)]
    lines += ["", f"| policy | earned more on {own} | the same with unequal seeds |", "|---|---|---|"]
    lines += [f"| {name} | {each.gap} | ± {each.unpaired:.3f} |" for name, each in verdicts.items()]
    lines += ["", *(f"Beware: {warning}." for warning in verdict.warnings(others) or [])]
    if not verdict.warnings(others):
        lines.append("Nothing to beware of.")
    return "\n".join(lines) + "\n"


def _row(name: str, physics: str, played: Played) -> str:
    why = sorted({reason for reason in played.failures if reason})
    failed = ", ".join([f"{played.failed:.0%} (< {played.failed_at_most:.0%})", *why])
    earned, last = Interval.of(played.reward), Interval.of(played.last_second)
    more = f"{played.success.mean():.0%} | {failed} | {played.change.mean():.2f} | {played.saturated.mean():.0%}"
    return f"| {name} | {physics} | {earned} | {last} | {more} |"
