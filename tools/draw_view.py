"""Draws the pictures of docs/view.md: the live page in a headless Chromium.

python tools/draw_view.py [FOLDER]          # needs playwright and a Chromium, which may be named in CHROMIUM
"""

import io
import os
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from fastcollide.view.program import run_to_view
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

ROOT = Path(__file__).parent.parent
PICTURES = ROOT / "docs" / "pictures"
PATIENCE = 180  # seconds: software draws a few pictures a second
sys.path.insert(0, str(ROOT / "tests"))
from serve_view import serving  # noqa: E402


def wait_until_still(page: Page) -> bytes:
    """A picture of the page once nothing on it moves."""
    end = time.monotonic() + PATIENCE
    before = page.screenshot()
    while time.monotonic() < end:
        time.sleep(1.5)
        after = page.screenshot()
        if after == before:
            return after
        before = after
    raise SystemExit("the page does not come to rest")


def save(picture: bytes, path: Path) -> None:
    """As small as PNG can be."""
    Image.open(io.BytesIO(picture)).convert("RGB").save(path, optimize=True)
    print(path, f"{path.stat().st_size / 1000:.0f} kB")


@dataclass(frozen=True)
class Shot:
    """A picture: the file; the scene, after so many frames; colours, theme and size [pixels] of the page, and the place
    on it of a sphere to be selected."""

    name: str
    scene: str
    frames: int
    color: str
    theme: str
    width: int
    height: int
    click: tuple[int, int]


SHOTS = (
    Shot("view.png", "dam_break.toml", 100, "speed", "light", 1280, 860, (470, 588)),
    Shot("view_phone.png", "report_5000.toml", 150, "contacts", "dark", 400, 800, (200, 300)),
)


def draw(browser: Browser, shot: Shot, folder: Path) -> None:
    """Draws one picture."""
    run = run_to_view(ROOT / "scenes" / shot.scene)
    for _ in range(shot.frames):
        run.advance()
    with serving(run) as served:
        context = browser.new_context(viewport={"width": shot.width, "height": shot.height}, color_scheme=shot.theme)
        page = context.new_page()
        page.set_default_timeout(1000 * PATIENCE)
        page.goto(served.page)
        wait_until_still(page)
        page.keyboard.press("End")
        page.keyboard.press("p" if page.locator("#color").is_hidden() else "Escape")
        page.select_option("#color", shot.color)
        wait_until_still(page)
        page.mouse.click(*shot.click)
        save(wait_until_still(page), folder / shot.name)
        context.close()


def main() -> None:
    """Draws all of them."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURES
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=chromium, args=["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        )
        for shot in SHOTS:
            draw(browser, shot, folder)


if __name__ == "__main__":
    main()
