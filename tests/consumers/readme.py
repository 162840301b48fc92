"""The README's lines of other libraries."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

README = Path(__file__).parents[2] / "README.md"


def run_line(start: str, **names: Any) -> Any:
    """What the README's line that begins with ``start`` makes of ``names``."""
    (block,) = re.findall(r"<!-- the libraries -->\n```python\n(.*?)```", README.read_text(encoding="utf-8"), re.S)
    (line,) = [line for line in block.splitlines() if line.startswith(start)]
    made: dict[str, Any] = {}
    exec(line, names, made)
    return made[start.split(" ")[0]]
