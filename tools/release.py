"""Check the files of a release and list them; nothing is published.

``python tools/release.py FOLDER``, by `make release`, after `make wheel` has written the files.
"""

import hashlib
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def faults(version: str) -> list[str]:
    """Return what is missing for a release of the tree."""
    status = subprocess.run(
        ["git", "status", "--porcelain"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    tags = subprocess.run(
        ["git", "tag", "--points-at", "HEAD"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split()
    conditions = {
        "the working tree has changes that are not committed": not status,
        f"CHANGELOG.md has no section {version}": f"\n## {version}" in read("CHANGELOG.md"),
        f"CITATION.cff has not the version {version}": f"version: {version}"
        in read("CITATION.cff"),
        f"no tag v{version} is at this commit": f"v{version}" in tags,
    }
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
    missing = faults(version)
    for text in missing:
        print(f"missing: {text}")
    print("A person publishes these files; see CONTRIBUTING.md.")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
