"""Build an extension repository: a folder for any static web server, from which Blender installs and updates.

    .venv/bin/python tools/build_repository.py [--python 3.11]… [--platform linux-x64]… [--out dist/repository]

It holds one zip for each Python and platform, index.json (what Blender asks for) and index.html (to drag from). In
Blender: Preferences › Get Extensions › Repositories › Add Remote Repository, with the address of index.json.
"""

from __future__ import annotations

import argparse
import html
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from build_extension import ROOT, BuildError, Target, build, read_source, run_blender_tool

OUT = ROOT / "dist" / "repository"
PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
  <meta charset="utf-8">
  <title>$name</title>
  <style>
    body { font: 16px/1.5 sans-serif; max-width: 60em; margin: 3em auto; padding: 0 1em; }
    table { border-collapse: collapse; } td, th { padding: .3em .8em; text-align: left; border-bottom: 1px solid #ccc; }
  </style>
</head>
<body>
<h1>$name</h1>
<p>$tagline. For Blender 4.2 and later.</p>
<p><b>Drag the link of your system into Blender</b> (twice the first time: Blender adds this repository, then installs).
Updates then arrive by themselves. By hand: <i>Preferences › Get Extensions › Repositories › Add Remote Repository</i>,
with the address of <a href="index.json">index.json</a>. Without a network: download the zip and drop it on Blender.</p>
${body}
<p>Built ${date}</p>
</body>
</html>
"""
"""Template of index.html, in which Blender's tool fills in ${body} and ${date}."""


def format_page(manifest: dict[str, Any]) -> str:
    """Format the HTML template that Blender's tool completes."""
    return PAGE.replace("$name", html.escape(manifest["name"])).replace("$tagline", html.escape(manifest["tagline"]))


def generate_index(folder: Path) -> dict[str, Any]:
    """Write index.json and index.html for the zips in a folder, and return the index.

    Raises BuildError where Blender's tool refuses a zip or warns, as it does of two zips for the same Blender.
    """
    with tempfile.TemporaryDirectory() as scratch:
        template = Path(scratch) / "page.html"
        template.write_text(format_page(read_source()["manifest"]), encoding="utf-8")
        output = run_blender_tool(
            "server-generate", "--repo-dir", str(folder), "--html", "--html-template", str(template), tags=False
        )
    problems = [line for line in output.splitlines() if line.startswith(("WARN", "ERROR", "FATAL"))]
    if problems:
        raise BuildError("Blender complains of the repository:\n" + "\n".join(problems))
    index: dict[str, Any] = json.loads((folder / "index.json").read_text(encoding="utf-8"))
    return index


def publish_zips(zips: list[Path], out: Path) -> dict[str, Any]:
    """Copy the zips to out, delete other versions there and return the new index. Raises BuildError."""
    out.mkdir(parents=True, exist_ok=True)
    for old in set(out.glob("*.zip")) - {out / path.name for path in zips}:
        old.unlink()
    for path in zips:
        if path.parent != out:
            shutil.copy2(path, out / path.name)
    return generate_index(out)


def main(arguments: list[str] | None = None) -> int:
    """Build every Python × platform, then the index; returns 1 with a clear message where something fails."""
    parser = argparse.ArgumentParser(description="Build an extension repository.")
    parser.add_argument("--python", action="append", metavar="X.Y", help="Python of Blender (default: all)")
    parser.add_argument("--platform", action="append", metavar="NAME", help="Blender's platform (default: all)")
    parser.add_argument("--out", type=Path, default=OUT, metavar="DIR")
    chosen = parser.parse_args(arguments)
    try:
        source = read_source()
        platforms, pythons = chosen.platform or source["platforms"], chosen.python or source["python"]
        targets = [Target(python, platform) for platform in platforms for python in pythons]
        index = publish_zips([build(target, chosen.out) for target in targets], chosen.out)
    except BuildError as error:
        print(error, file=sys.stderr)
        return 1
    for entry in index["data"]:
        print(f"{entry['archive_url']} ({entry['archive_size'] / 1e6:.1f} MB)")
    print(f"{chosen.out / 'index.json'}: {len(index['data'])} zips")
    return 0


if __name__ == "__main__":
    sys.exit(main())
