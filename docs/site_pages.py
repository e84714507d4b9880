"""Gather the pages of the site: `python docs/site_pages.py FOLDER`, for `make docs`.

Pages link to each other, and to code, YAML and pictures, as they lie in the checkout. They and what
they link to are copied in the same places, so that the site's own check finds every link.
"""

import re
import shutil
import sys
from pathlib import Path

from lipservo_lab.bench.house.code_lines import pages

ROOT = Path(__file__).parents[1]
#: Of Markdown; titles after the address, and addresses in angle brackets, are not used here.
LINK = re.compile(r"\]\(([^)\s#]+)")


def gather(folder: Path) -> None:
    """Copy all pages, and the files that they link to; a link to a folder is one to its files."""
    for page in pages(ROOT):
        linked = [
            (page.parent / target).resolve()
            for target in LINK.findall(page.read_text("utf-8"))
            if not target.startswith(("http:", "https:", "mailto:"))
        ]
        for path in (page, *linked):
            if path.is_file() and path.is_relative_to(ROOT):
                place = folder / path.relative_to(ROOT)
                place.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, place)


if __name__ == "__main__":
    gather(Path(sys.argv[1]))
