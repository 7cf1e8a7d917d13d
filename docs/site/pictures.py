"""The pictures of the docs: ``python docs/site/pictures.py`` takes the tutorial's from the pages that its own commands write,
``python docs/site/pictures.py gallery`` runs the gallery's code.
"""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "pictures"
TOWS, STEADY = "sample_videos/mariner/x*", "sample_videos/leander_steady/hole*"
COMMANDS = (
    f"towline run {TOWS}",
    f"towline run {STEADY}",
    f"towline identify {TOWS}",
    "towline check sample_videos/mariner/x1446",
    "towline rectify sample_videos/mariner/x1446 --grid",
    "cp -r sample_videos/mariner wrong && sed -i 's#video = .*#tracks = \"out/tracks.csv\"#' wrong/x*/run.toml",
    "sed -i 's/line_length_m = 0.91/line_length_m = 0.90/' wrong/x*/run.toml",
    "towline diagnose wrong/x1446 wrong/x1751",
)
MARINER, X1446 = "sample_videos/mariner/out", "sample_videos/mariner/x1446/out"
TAKEN = (
    ("frame.webp", f"{MARINER}/report.html", "a frame of the recording"),
    ("tracks.svg", f"{MARINER}/report.html", "pixel coordinates u and v"),
    ("motion.svg", f"{MARINER}/report.html", "tow line angle, heading"),
    ("residuals.svg", f"{MARINER}/report.html", "residuals of sideways place"),
    ("whiteness.svg", f"{MARINER}/derivatives.html", "autocorrelation and histogram"),
    ("consistency.svg", f"{MARINER}/derivatives.html", "estimates of each run alone"),
    ("invariants.svg", f"{X1446}/check.html", "invariants of"),
    ("line.svg", "sample_videos/leander_steady/out/report.html", "tow point over one by"),
    ("ladder.svg", "wrong/out/gap.html", "probabilities of the hypotheses"),
)
"""Picture, the page that holds it, how its alternative text begins: the first such picture of the page."""
GRID_WIDTH_PX = 640
PAGE_PX = (1280, 1320)
"""Window in which the README's page is seen: down to the numbers beside the six."""
PAGE_WIDTH_PX = 900


def main() -> None:
    """Make the tutorial's anew."""
    with tempfile.TemporaryDirectory() as name:
        folder = samples(Path(name), "out", "truth", "*.md")
        path = f"export PATH='{Path(sys.executable).parent}':$PATH; "
        for command in COMMANDS:
            subprocess.run(["bash", "-c", path + command], cwd=folder, check=True)
        for picture, page, begins in TAKEN:
            write(PICTURES / picture, taken((folder / page).read_text(encoding="utf-8"), begins))
        write(PICTURES / "grid.webp", (folder / X1446 / "grid.png").read_bytes())
        write(PICTURES / "page.webp", seen(folder / MARINER / "derivatives.html"), PAGE_WIDTH_PX)


def gallery() -> None:
    """Make the gallery's anew: each page's own code draws its picture."""
    for page in sorted((ROOT / "docs" / "gallery").glob("*.md")):
        blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        if not blocks:
            continue
        with tempfile.TemporaryDirectory() as name:
            folder = samples(Path(name), "out")
            subprocess.run([sys.executable, "-c", "\n".join(blocks)], cwd=folder, check=True)
            drawn = f"{page.stem}.webp"
            shutil.copyfile(folder / drawn, PICTURES / f"gallery_{drawn}")


def samples(folder: Path, *without: str) -> Path:
    """A folder with the sample recordings."""
    shutil.copytree(ROOT / "sample_videos", folder / "sample_videos", ignore=shutil.ignore_patterns(*without))
    return folder


def taken(page: str, begins: str) -> bytes:
    """The first picture of a page whose alternative text begins so."""
    for image in re.findall(r"<img [^>]*>", page):
        if f'alt="{begins}' in image:
            return base64.b64decode(re.findall(r'src="data:image/[\w+]+;base64,([^"]+)"', image)[0])
    raise LookupError(f"no picture {begins!r}")


def seen(page: Path) -> bytes:
    """The top of a page as Chromium shows it."""
    shot = page.with_suffix(".png")
    size = ",".join(map(str, PAGE_PX))
    asked = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--window-size={size}"]
    subprocess.run(["chromium", *asked, f"--screenshot={shot}", page.as_uri()], check=True, capture_output=True)
    return shot.read_bytes()


def write(path: Path, data: bytes, widest_px: int = GRID_WIDTH_PX) -> None:
    """As it is (SVG), or coded as WebP."""
    if path.suffix == ".svg":
        path.write_bytes(data)
        return
    import cv2
    import numpy as np

    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    if picture.shape[1] > widest_px:
        size = (widest_px, round(picture.shape[0] * widest_px / picture.shape[1]))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_WEBP_QUALITY, 82])


if __name__ == "__main__":
    gallery() if sys.argv[1:] == ["gallery"] else main()
