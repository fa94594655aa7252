"""docs/performance.md has the tables that tools/draw_performance.py makes of the committed results, and no others."""

import csv
import importlib.util
import re
from pathlib import Path

import pytest
from fastcollide import bench_report
from fastcollide.bench import Row

ROOT = Path(__file__).parent.parent.parent


@pytest.fixture(scope="module")
def draw_performance():
    spec = importlib.util.spec_from_file_location("draw_performance", ROOT / "tools" / "draw_performance.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_that_of_the_results(draw_performance):
    page = draw_performance.PAGE.read_text(encoding="utf-8")
    assert draw_performance.updated(page, draw_performance.read_results()) == page
    assert draw_performance.PICTURE.exists()


def test_links_lead_somewhere():
    page = ROOT / "docs" / "performance.md"
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"\]\(([^)#]+)\)", text):
        assert (page.parent / name).exists(), name
    for name in re.findall(r"`((?:src|tools|docs|benchmarks)/[^`]+)`", text):
        assert (ROOT / name).exists(), name


def test_the_table_of_sizes_has_a_row_for_each_ratio_and_a_column_for_each_way(draw_performance, tmp_path):
    (tmp_path / "machine").mkdir()
    (tmp_path / "machine" / "mixed_sizes.csv").write_text(
        "device_name,spheres,ratio,solver,method,ms\n"
        "A Card,20000,1.0,substep,levels,0.5\nA Card,20000,1.0,substep,list,0.25\nA Card,20000,1.0,reference,list,9\n"
        "A Card,20000,32.0,substep,levels,1.25\n"
    )
    assert draw_performance.tables_of_sizes(tmp_path) == (
        "\nA Card (`benchmarks/results/machine`):\n\n"
        "| sizes | 20,000 by levels | 20,000 by list |\n| --- | --- | --- |\n"
        "| 1:1 | 0.5 | 0.25 |\n| 1:32 | 1.25 | – |\n\n"
    )


ROW = Row(
    device="cpu", device_name="Some Processor (2 threads)", spheres=2000, solver="reference", method="cells",
    frames=60, repeats=5, ms=8.0, ms_fastest=7.0, ms_slowest=9.0, ms_one_by_one=9.5, times_yardstick=1.0,
    contacts_per_sphere=0.5, model_bytes=490, copy_gb_s=24.5, roof_share=0.005, state_hash="1" * 16, stages={},
)  # fmt: skip
SUBSTEP = {"solver": "substep", "method": "list", "ms": 4.0, "times_yardstick": 2.04, "contacts_per_sphere": 1.25}
STAGES = {"build_grid": 1.0, "make_lists": 2.0, "gather_contacts": 4.0, "apply_contacts": 5.0}


def write_results(folder, *changes, name="bench.csv"):
    folder.mkdir(exist_ok=True)
    lines = [bench_report.csv_row(Row(**{**vars(ROW), **change}), "a note") for change in changes]
    with (folder / name).open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, lines[0])
        writer.writeheader()
        writer.writerows(lines)


def test_runs_of_one_machine_share_its_table(draw_performance, tmp_path):
    write_results(tmp_path / "machine", {})
    write_results(tmp_path / "machine", {"spheres": 30_000, "repeats": 1}, name="bench_large.csv")
    text = draw_performance.tables(draw_performance.read_results(tmp_path))
    assert text.count("### ") == 1
    assert "medians of 1 to 5 repeats" in text
    assert "| 30,000 |" in text


def test_a_table_has_the_figures_of_its_csv(draw_performance, tmp_path):
    substep = {**SUBSTEP, "roof_share": 0.0123, "stages": STAGES, "state_hash": "2" * 16}
    by_itself = {**substep, "method": "auto", "ms": 4.5, "ms_one_by_one": 5.25}
    write_results(tmp_path / "machine", {}, substep, by_itself)
    text = draw_performance.tables(draw_performance.read_results(tmp_path))
    assert text.startswith("### Some Processor (2 threads)\n")
    assert "medians of 5 repeats; copy 24 GB/s; a note." in text
    (line,) = [line for line in text.splitlines() if line.startswith("| 2,000")]
    assert line == "| 2,000 | 8 | – | 4 (2×) | – | 5.25 | 1.2 % | 1.2 | 25 % |"


def test_what_was_not_measured_is_a_dash(draw_performance, tmp_path):
    unknown = {"times_yardstick": None, "copy_gb_s": None, "roof_share": None, "stages": STAGES}
    write_results(tmp_path / "machine", {**SUBSTEP, **unknown})
    text = draw_performance.tables(draw_performance.read_results(tmp_path))
    assert "copy not measured" in text
    assert "| 2,000 | – | – | 4 | – | – | – | 1.2 | 25 % |" in text


def test_machines_with_different_states_are_no_page(draw_performance, tmp_path):
    write_results(tmp_path / "one", {})
    others = {"spheres": 3000}, {"solver": "substep"}, {"frames": 30}
    write_results(tmp_path / "three", *[{**other, "state_hash": "3" * 16} for other in others])
    assert len(draw_performance.read_results(tmp_path)) == 2
    write_results(tmp_path / "two", {"device": "cuda:0", "state_hash": "4" * 16})
    with pytest.raises(SystemExit, match=r"2000 spheres, reference: two \(cuda:0\) and one ended in different states"):
        draw_performance.read_results(tmp_path)


def test_the_picture_has_a_panel_for_each_device(draw_performance, monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    image = pytest.importorskip("PIL.Image")
    widths = []
    for machine, copy in (("one", 24.5), ("two", None)):
        rows = {}, {"spheres": 9000}, SUBSTEP
        write_results(tmp_path / machine, *[{**row, "copy_gb_s": copy} for row in rows])
        monkeypatch.setattr(draw_performance, "PICTURE", tmp_path / "picture.png")
        draw_performance.draw(draw_performance.read_results(tmp_path))
        with image.open(tmp_path / "picture.png") as picture:
            widths.append(picture.width)
    assert widths[1] == 2 * widths[0]
