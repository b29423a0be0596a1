"""python -m demo.gallery WINGD DOCS: runs the notebooks on the demonstration's flight; writes the gallery page and its figures."""

from __future__ import annotations

import contextlib
import io
import os
import re
import runpy
import sys
import tempfile
import textwrap
import warnings
from pathlib import Path

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
# Questions in the order of the page, by the names of their notebooks.
ORDER = ("deflection_over_lift", "fem", "before_and_after", "left_and_right", "surface", "loads", "modes", "fleet")
# Width of a figure, px, and number of its colours: a figure is below 60 kB.
WIDTH_PX, COLOURS = 720, 48
# Longest line of the page, characters.
LINE = 160
HEAD = """# Gallery

You choose the notebook that answers your question about a measured wing by its figure. Each runs on the flight of `wingd demo`, or on your store with
`WINGD_STORE=`. Bands and bars are one standard deviation.
"""


def page() -> str:
    """Return the page: heading, first paragraph and figures of each notebook."""
    sections = []
    for name in ORDER:
        text = (NOTEBOOKS / f"{name}.py").read_text()
        title, *body = [line[2:] for line in re.match(r"# %% \[markdown\]\n((?:#.*\n)+)", text)[1].splitlines()]
        figures = re.findall(r'savefig\("(\w+\.png)"\)', text)
        images = "\n".join(f"![{title.lstrip('# ')}](images/gallery/{figure})" for figure in figures)
        words = textwrap.fill(f"{' '.join(body).strip()} Notebook: `python/notebooks/{name}.py`.", LINE)
        sections.append(f"## {title.lstrip('# ')}\n\n{words}\n\n{images}\n")
    return "\n".join([HEAD, *sections])


def draw(store: Path, images: Path) -> None:
    """Run the notebooks in an empty folder and write their figures, reduced in size."""
    import matplotlib.pyplot as plt
    from PIL import Image

    from wingd.plot import STYLE

    plt.style.use(STYLE)
    plt.switch_backend("agg")
    os.environ["WINGD_STORE"] = str(store.resolve())
    images.mkdir(parents=True, exist_ok=True)
    for name in ORDER:
        with (
            tempfile.TemporaryDirectory() as folder,
            contextlib.chdir(folder),
            contextlib.redirect_stdout(io.StringIO()),
            warnings.catch_warnings(action="ignore"),
        ):
            runpy.run_path(str(NOTEBOOKS / f"{name}.py"))
            plt.close("all")
            drawn = {file.name: Image.open(file).convert("RGB") for file in sorted(Path(folder).glob("*.png"))}
        for figure, image in drawn.items():
            image.thumbnail((WIDTH_PX, WIDTH_PX), Image.Resampling.LANCZOS)
            image.quantize(COLOURS).save(images / figure, optimize=True)
            print(f"{images / figure}: {(images / figure).stat().st_size / 1000:.0f} kB")


def main(wingd: str, docs: str) -> None:
    """Write the page and its figures."""
    from demo.prepare import solve_jointly

    os.environ["WINGD"], folder = wingd, Path(docs).resolve()
    with tempfile.TemporaryDirectory() as work:
        os.environ["WINGD_CACHE"] = f"{work}/cache"
        draw(solve_jointly(wingd, Path(work) / "demo"), folder / "images" / "gallery")
    (folder / "gallery.md").write_text(page())


if __name__ == "__main__":
    main(*sys.argv[1:])
