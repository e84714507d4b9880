"""What an installation brings: megabytes of a distribution and of all that it requires."""

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Final

from packaging.requirements import Requirement

#: Ours run from the checkout, where a wheel would have copies of these folders.
_OURS: Final = {
    "lipservo": ("calibration", "firmware_bridge", "lipservo", "lipsync", "config"),
    "lipservo-client": ("client/lipservo_client",),
}


def installed_mb(root: Path, required: str) -> float:
    """Return how many MB a requirement, such as `lipservo[dashboard]`, takes on the disk.

    All that it depends on is counted, byte code too, but nothing that is not installed here. root:
    of the checkout.
    """
    needed: set[tuple[str, str]] = set()
    _add_requirement(required, needed)
    files = {path for name in {name for name, _ in needed} for path in _files(root, name)}
    return sum(path.stat().st_blocks for path in files if path.is_file()) * 512 / 2**20


def _add_requirement(text: str, needed: set[tuple[str, str]], extra: str = "") -> None:
    """Add a requirement and all that it depends on to `needed`, as (distribution, extra).

    text: as in a distribution's metadata. extra: the extra for which it is required; "": for none.
    Extra "" in `needed`: the distribution without extras.
    """
    requirement = Requirement(text)
    if requirement.marker and not requirement.marker.evaluate({"extra": extra}):
        return
    name = requirement.name.lower()
    for wanted_extra in {"", *requirement.extras} - {e for n, e in needed if n == name}:
        needed.add((name, wanted_extra))
        try:
            dependencies = distribution(name).requires or ()
        except PackageNotFoundError:
            dependencies = ()
        for dependency in dependencies:
            _add_requirement(dependency, needed, wanted_extra)


def _files(root: Path, name: str) -> Iterator[Path]:
    """Yield the paths in a distribution: of ours from the checkout, of others as installed.

    Nothing for a distribution that is not installed.
    """
    if folders := _OURS.get(name):
        for folder in folders:
            yield from (root / folder).rglob("*")
        return
    try:
        yield from (Path(str(each.locate())) for each in distribution(name).files or ())
    except PackageNotFoundError:
        return
