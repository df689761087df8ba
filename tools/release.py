"""Check the files of a release and list them; nothing is published.

``python tools/release.py FOLDER``, by `make release`, after `make wheel` has written the files.
"""

import hashlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
LINUX = [
    f"{libc}_*_{machine}"
    for libc in ("manylinux", "musllinux")
    for machine in ("x86_64", "aarch64")
]
PLATFORMS = (*LINUX, "macosx_*_arm64", "macosx_*_x86_64", "win_amd64")


def faults(version: str, files: list[Path]) -> list[str]:
    """Return what is missing for a release of the tree by these files."""
    status = subprocess.run(
        ["git", "status", "--porcelain"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    tags = subprocess.run(
        ["git", "tag", "--points-at", "HEAD"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split()
    settings = tomllib.loads(read("pyproject.toml"))
    pythons = [build.strip("-*") for build in settings["tool"]["cibuildwheel"]["build"]]
    absent = {
        platform: [
            p
            for p in pythons
            # the tag of the interpreter says nothing of threads
            if not any(f.match(f"*-{p.rstrip('t')}-{p}-*{platform}.whl") for f in files)
        ]
        for platform in PLATFORMS
    }
    conditions = {
        "no public address, [project.urls] in pyproject.toml": "urls" in settings["project"],
        "README.md has links that need the public address": "](docs/" not in read("README.md"),
        "the working tree has changes that are not committed": not status,
        f"CHANGELOG.md has no section {version}": f"\n## {version}" in read("CHANGELOG.md"),
        f"CITATION.cff has not the version {version}": f"version: {version}"
        in read("CITATION.cff"),
        f"no tag v{version} is at this commit": f"v{version}" in tags,
    }
    conditions |= {f"no wheel {key} of {', '.join(p)}": not p for key, p in absent.items()}
    return [text for text, met in conditions.items() if not met]


def read(name: str) -> str:
    """Return the text of a file of the tree."""
    return (ROOT / name).read_text("utf-8")


def main(folder: str) -> int:
    """Check and list the files; return 1 if anything is missing."""
    (version,) = re.findall(r"^  version: '(.*)'", read("meson.build"), re.MULTILINE)
    files = sorted(Path(folder).glob(f"crouch_grossman-{version}*"))
    subprocess.run([sys.executable, "-m", "twine", "check", "--strict", *files], check=True)
    for file in files:
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        print(f"{file.name}  {file.stat().st_size} bytes  sha256 {digest}")
    missing = faults(version, files)
    for text in missing:
        print(f"missing: {text}")
    print("A person publishes these files; see CONTRIBUTING.md.")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
