"""The live page in a real browser: headless Chromium with software WebGL2. Skipped where there is no Chromium."""

import io
import os
import shutil
import time

import fastcollide as fc
import numpy as np
import pytest
from fastcollide.frames import frame_path, write_frame
from fastcollide.view.finished import FinishedRun
from fastcollide.view.live import LiveRun
from PIL import Image
from serve_view import live_run, serving

playwright = pytest.importorskip("playwright.sync_api")

CHROMIUM = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt install chromium, or name it in CHROMIUM")

PATIENCE = 90  # seconds until a test gives up: software draws a few pictures a second
SIZE = {"width": 900, "height": 560}
SCENE = {"x": 60, "y": 90, "width": 520, "height": 370}  # the part of the page that only shows spheres


@pytest.fixture(scope="module")
def chromium():
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=CHROMIUM, args=["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        )
        yield browser
        browser.close()


@pytest.fixture
def open_page(chromium):
    """open_page(served, ...): the page of a server, with its first picture; nothing it complains of is let pass."""
    complaints, contexts = [], []

    def open_it(served, **options):
        context = chromium.new_context(**{"viewport": SIZE, "color_scheme": "light", **options})
        context.set_default_timeout(1000 * PATIENCE)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda line: complaints.append(line.text) if line.type == "error" else None)
        page.goto(served.page)
        wait_until(lambda: page.text_content("#fps") or has_many_colors(page), "a first picture")
        return page

    yield open_it
    for context in contexts:
        context.close()
    assert complaints == []


def wait_until(condition, what="it"):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, f"{what} does not come"
        time.sleep(0.05)


def pixels(page, clip=SCENE):
    return np.asarray(Image.open(io.BytesIO(page.screenshot(clip=clip))).convert("RGB")).astype(int)


def has_many_colors(page):
    return len(np.unique(pixels(page).reshape(-1, 3), axis=0)) > 100


def changed(before, after):
    """The share of the pixels that differ."""
    return float((np.abs(before - after).max(axis=2) > 8).mean())


def settled(page):
    """Pixels that stay as they are."""
    before = pixels(page)
    while True:
        time.sleep(0.5)
        after = pixels(page)
        if changed(before, after) == 0:
            return after
        before = after


def frame(page):
    return int(page.text_content("#frame"))


def wait_for_frame(page, wanted):
    wait_until(lambda: frame(page) == wanted, f"frame {wanted} (found {frame(page)})")


def still_world(positions, **options):
    """A live run of large spheres that rest in mid-air, but for the first one, which flies up at 2 m/s."""

    def create():
        world = fc.World(bounds=((-4, -4, 0), (4, 4, 8)), gravity=(0, 0, 0), drag=0.0, device="cpu", **options)
        world.add(position=positions, radius=0.9, velocity=[(0, 0, 2)] + [(0, 0, 0)] * (len(positions) - 1))
        return world

    return LiveRun(create, "Three", fps=10)


THREE = [(-2.5, 0, 2), (0, 0, 4), (2.5, 0, 6)]


def test_pixels_change_while_it_plays_and_not_while_it_pauses(open_page):
    # Without gravity, so that the spheres are still on their way however late a picture comes.
    with serving(live_run(1000, gravity=(0, 0, 0), drag=0.0), is_playing=True) as served:
        page = open_page(served)
        before = pixels(page)
        wait_until(lambda: changed(before, pixels(page)) > 0.01, "another picture")
        page.click("#play")
        wait_until(lambda: not served.player.status.is_playing)
        before = settled(page)
        at = served.player.run.world.frame
        time.sleep(2)
        assert changed(before, pixels(page)) == 0
        assert served.player.run.world.frame == at

        page.keyboard.press("Escape")
        page.locator("#view").focus()
        page.keyboard.press("Space")
        wait_until(lambda: changed(before, pixels(page)) > 0.01, "another picture")
        assert served.player.status.is_playing


def test_sliders_change_the_physics(open_page):
    with serving(live_run(1000, drag=0.0)) as served:
        page, world = open_page(served), served.player.run.world
        assert page.locator("label[for=gravity] + output").text_content() == "-9.8 m/s²"
        page.focus("#gravity")
        page.keyboard.press("End")
        wait_until(lambda: world.gravity[2] == 30)
        assert page.locator("label[for=gravity] + output").text_content() == "30 m/s²"
        before = world.velocities[:, 2].mean()
        page.click("#step")
        wait_for_frame(page, 1)
        assert world.velocities[:, 2].mean() - before == pytest.approx(30 / 60, rel=0.2)

        for name, key, read in (
            ("drag", "End", lambda: world.drag == 5),
            ("restitution", "Home", lambda: (world.restitutions == 0).all()),
            ("floor_restitution", "End", lambda: world.floor_restitution == 1),
            ("friction", "End", lambda: world.has_spin and (world.frictions == 2).all()),
            ("wall_friction", "End", lambda: world.wall_friction == 2),
        ):
            page.focus(f"#{name}")
            page.keyboard.press(key)
            wait_until(read, name)


def test_a_step_is_exactly_one_frame_and_reset_gives_the_state_of_the_start(open_page):
    with serving(live_run(1000)) as served:
        page = open_page(served)
        start = f"State hash {served.player.run.world.state_hash():016x}"
        wait_until(lambda: page.text_content("#state") == start)
        reference = live_run(1000).world
        for wanted in (1, 2, 3):
            page.click("#step")
            wait_for_frame(page, wanted)
            reference.step(1, dt=1 / 60)
            assert served.player.run.world.state_hash() == reference.state_hash()
        wait_until(lambda: page.text_content("#state") == f"State hash {reference.state_hash():016x}")
        page.focus("#drag")
        page.keyboard.press("End")
        page.keyboard.press("r")
        wait_for_frame(page, 0)
        wait_until(lambda: page.text_content("#state") == start)
        assert page.input_value("#drag") == "0.06"


def test_the_past_of_a_live_run_can_be_looked_at(open_page):
    with serving(live_run(1000)) as served:
        page = open_page(served)
        for wanted in range(1, 5):
            page.keyboard.press("ArrowRight")
            wait_for_frame(page, wanted)
        now = settled(page)
        page.keyboard.press("Home")
        wait_for_frame(page, 0)
        assert changed(now, settled(page)) > 0.005
        page.keyboard.press("End")
        wait_for_frame(page, 4)
        assert changed(now, settled(page)) == 0
        assert served.player.run.world.frame == 4


def places_by_color(page):
    """Where the three spheres are on the page: by number, coloured blue, magenta and yellow."""
    picture = pixels(page)
    red, green, blue = (picture[..., channel] for channel in range(3))
    masks = (
        (blue > red + 50) & (blue > green + 50),
        (red > green + 60) & (blue > green + 20),
        (red > blue + 60) & (green > blue + 40),
    )
    assert all(mask.sum() > 300 for mask in masks), [int(mask.sum()) for mask in masks]
    return [(SCENE["x"] + np.nonzero(mask)[1].mean(), SCENE["y"] + np.nonzero(mask)[0].mean()) for mask in masks]


def test_a_click_shows_the_sphere_that_was_clicked(open_page):
    with serving(still_world(THREE)) as served:
        page = open_page(served)
        page.select_option("#color", "id")
        settled(page)
        for sphere, place in enumerate(places_by_color(page)):
            page.mouse.click(*place)
            wait_until(
                lambda sphere=sphere: page.text_content("#sphere-name") == f"Sphere {sphere}", f"sphere {sphere}"
            )
            wait_until(lambda: page.locator("#sphere-data dd").count())
            position = page.locator("#sphere-data dd[data-name=position]").text_content()
            assert position == ", ".join(f"{x:g}" for x in THREE[sphere])
            assert page.locator("#sphere-data dd[data-name=contacts]").text_content() == "none"
        page.mouse.click(SCENE["x"] + 5, SCENE["y"] + 5)
        wait_until(lambda: page.locator("#sphere").is_hidden())


def test_the_camera_follows_a_sphere_and_goes_home(open_page):
    with serving(still_world(THREE)) as served:
        page = open_page(served)
        page.select_option("#color", "id")
        settled(page)
        home = places_by_color(page)
        page.mouse.click(*home[0])
        wait_until(lambda: page.text_content("#sphere-name") == "Sphere 0")
        page.click("#follow")
        settled(page)
        before = places_by_color(page)
        for wanted in (1, 2, 3):  # 0.6 m up, two thirds of a radius
            page.keyboard.press("ArrowRight")
            wait_for_frame(page, wanted)
        settled(page)
        after = places_by_color(page)
        assert after[0] == pytest.approx(before[0], abs=2)
        assert after[1][1] > before[1][1] + 5  # the others seem to go down

        page.keyboard.press("h")
        page.keyboard.press("Escape")
        settled(page)
        again = places_by_color(page)
        assert again[1] == pytest.approx(home[1], abs=1)
        assert again[0][1] < home[0][1] - 5  # it has gone up itself


def test_the_mouse_turns_and_the_wheel_comes_nearer(open_page):
    with serving(still_world(THREE)) as served:
        page = open_page(served)
        before = settled(page)
        page.mouse.move(300, 250)
        page.mouse.down()
        page.mouse.move(380, 270, steps=4)
        page.mouse.up()
        turned = settled(page)
        assert changed(before, turned) > 0.01
        assert page.locator("#sphere").is_hidden()  # a drag is no click
        page.mouse.wheel(0, -400)
        time.sleep(0.5)
        assert changed(turned, settled(page)) > 0.01


def test_colours_show_what_was_chosen(open_page):
    with serving(live_run(1000)) as served:
        page = open_page(served)
        seen = [settled(page)]
        for by in ("radius", "id", "contacts"):
            page.select_option("#color", by)
            time.sleep(0.5)
            seen.append(settled(page))
            assert page.text_content("#legend-unit") == {"radius": "m", "id": "number", "contacts": "contacts"}[by]
            for other in seen[:-1]:
                assert changed(other, seen[-1]) > 0.01, by


def test_a_picture_can_be_saved(open_page):
    with serving(live_run(1000)) as served:
        page = open_page(served)
        page.click("#step")
        wait_for_frame(page, 1)
        with page.expect_download() as download:
            page.keyboard.press("s")
        assert download.value.suggested_filename == "fastcollide_00000001.png"
        picture = Image.open(download.value.path())
        assert picture.format == "PNG"
        assert picture.size == (SIZE["width"], SIZE["height"])
        assert len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)) > 100


def test_a_finished_run_can_be_scrubbed(open_page, tmp_path):
    world = live_run(1000).world
    for _ in range(6):
        world.step(4)
        write_frame(frame_path(tmp_path, world.frame), world.frame, world.time, world.positions, world.radii)
    with serving(FinishedRun(tmp_path, world.bounds)) as served:
        page = open_page(served)
        assert page.locator("#conditions").is_hidden()
        first = settled(page)
        page.focus("#timeline")
        page.keyboard.press("End")
        wait_for_frame(page, 24)
        last = settled(page)
        assert changed(first, last) > 0.01
        page.keyboard.press("ArrowLeft")
        wait_for_frame(page, 20)
        page.keyboard.press("Home")
        wait_for_frame(page, 4)
        assert changed(first, settled(page)) == 0
        page.click("#play")
        wait_for_frame(page, 24)
        wait_until(lambda: page.get_attribute("#play", "aria-label") == "Play", "the end")


def test_light_and_dark(open_page):
    with serving(live_run(100)) as served:
        page = open_page(served, color_scheme="dark")
        corner = {"x": 20, "y": 100, "width": 8, "height": 8}
        assert pixels(page, corner).mean() < 40
        page.keyboard.press("t")
        wait_until(lambda: pixels(page, corner).mean() > 220)
        page.reload()  # it is remembered
        wait_until(lambda: pixels(page, corner).mean() > 220)


def test_the_width_of_a_phone(open_page):
    with serving(live_run(100)) as served:
        page = open_page(served, viewport={"width": 360, "height": 700}, has_touch=True, is_mobile=True)
        assert page.locator("#panel").is_hidden()
        page.tap("#show-panel")
        wait_until(lambda: page.locator("#gravity").is_visible())
        assert page.evaluate("document.documentElement.scrollWidth") == 360
        for name in ("#play", "#step", "#back", "#reset", "#timeline", "#speed", "#screenshot", "#theme", "#gravity"):
            box = page.locator(name).bounding_box()
            assert box["x"] >= 0, name
            assert box["x"] + box["width"] <= 360, name
            assert box["y"] + box["height"] <= 700, name
        page.tap("#step")
        wait_for_frame(page, 1)


def test_what_goes_wrong_is_shown(open_page, monkeypatch):
    with serving(live_run(100)) as served:

        def refuse(conditions):
            raise fc.InvalidValue("drag: found something; allowed: nothing", "drag")

        monkeypatch.setattr(served.player.run, "change", refuse)
        page = open_page(served)
        page.focus("#drag")
        page.keyboard.press("End")
        wait_until(lambda: page.locator("#note").is_visible(), "a note")
        assert page.text_content("#note") == "drag: found something; allowed: nothing"
        assert page.input_value("#drag") == "0.06"  # what holds still
    wait_until(lambda: "The connection has ended" in page.text_content("#note"), "a note")


def test_a_reference_run_has_no_slider_for_what_it_lacks(open_page):
    with serving(still_world(THREE, solver="reference")) as served:
        page = open_page(served)
        wait_until(lambda: page.locator("#drag").is_visible())
        assert page.locator("#friction").is_hidden()
