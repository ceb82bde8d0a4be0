"""What a scenario saw, one JSON object a line in results.jsonl, flushed as it happens: a crash loses nothing."""

import json
from pathlib import Path


class Record:
    """folder: where results.jsonl is written."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file = (folder / "results.jsonl").open("w", encoding="utf-8")
        self._check = ""

    def write(self, event: str, **facts: object) -> None:
        """One line: {"event": event, "check": the running one, **facts}."""
        self._file.write(json.dumps({"event": event, "check": self._check} | facts, default=str) + "\n")
        self._file.flush()

    def begin(self, check: str) -> None:
        self._check = check
        self.write("begin")

    def end(self, error: str, seconds: float) -> None:
        self.write("end", error=error, seconds=round(seconds, 2))
        self._check = ""
