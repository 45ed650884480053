"""Pictures and films of a run: what is in them, what kinds of files there are, and how bad input is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from plants import QUIET, plant_of, scenario
from processes import run_to_end
from recorded import Array, rows_of, write_folder
from refused import refused

WOOD = np.array([0.72, 0.54, 0.36])
"""About the table's colour in the light."""


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a second of four arms that hold a table."""
    plant = plant_of(scenario(plant=QUIET))
    return write_folder(tmp_path_factory.mktemp("film") / "run", plant, rows_of(plant, 500))


def rendered(*arguments: str | Path, cwd: Path) -> None:
    """A ``palanquin render`` that works; the test is skipped on a machine that has nothing to render with."""
    done = run_to_end("render", *arguments, cwd=cwd)
    if done.returncode == 3:
        assert "libegl1" in done.stderr
        assert "libosmesa6" in done.stderr
        assert not any(cwd.iterdir())
        pytest.skip("no library for off-screen OpenGL on this machine (EGL or OSMesa)")
    assert done.returncode == 0, done.stderr


@pytest.mark.system
def test_a_still_shows_the_table_and_all_of_its_caption(run_folder: Path, tmp_path: Path) -> None:
    rendered(run_folder, "--out", "still.png", cwd=tmp_path)
    picture = np.asarray(Image.open(tmp_path / "still.png").convert("RGB")) / 255
    assert picture.shape == (720, 1280, 3)
    wooden = (np.abs(picture - WOOD) < 0.12).all(axis=2)
    assert 0.005 < wooden.mean() < 0.3, "the table is in the picture, and not all of it"
    caption = picture[-80:]
    assert (caption.max(axis=2) < 0.3).mean() > 0.01  # letters
    assert (caption.min(axis=2) > 0.8).mean() > 0.5  # on a light ground


@pytest.mark.system
@pytest.mark.parametrize(("name", "frames"), [("film.gif", 6), ("film.mp4", 5), ("single", 5)])
def test_a_film_has_a_picture_for_each_of_its_times(run_folder: Path, tmp_path: Path, name: str, frames: int) -> None:
    """0 to 0.495 s, slowed down: at 12.5 and at 10 pictures a second."""
    fps = [] if name.endswith("gif") else ["--fps", "10"]
    rendered(run_folder, "--out", name, "--speed", "1.2", "--size", "160x120", *fps, cwd=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert len(pictures(tmp_path / name)) == frames
    assert {picture.shape for picture in pictures(tmp_path / name)} == {(120, 160, 3)}


def pictures(path: Path) -> list[Array]:
    """All pictures of a film."""
    if path.is_dir():
        return [np.asarray(Image.open(file)) for file in sorted(path.iterdir())]
    if path.suffix == ".mp4":
        import av

        with av.open(str(path)) as film:
            return [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    found = []
    with Image.open(path) as film:
        for k in range(getattr(film, "n_frames", 1)):
            film.seek(k)
            found.append(np.asarray(film.convert("RGB")))
    return found


REFUSED = {
    "no_run": (["nowhere", "--out", "still.png"], "nowhere is no run folder"),
    "kind": (["RUN", "--out", "film.avi"], "film.avi: expected a name that ends in .png, .gif or .mp4"),
    "no_folder": (["RUN", "--out", "not/there.png"], "there is no folder"),
    "size": (["RUN", "--size", "4000x2000"], "--size 4000x2000: expected"),
    "odd": (["RUN", "--size", "641x360"], "--size 641x360: expected"),
    "backwards": (["RUN", "--out", "film.gif", "--from-s", "0.4", "--to-s", "0.1"], "is after"),
}


@pytest.mark.parametrize(("arguments", "said"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_rendered_is_refused_in_one_sentence(
    run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "egl")  # as the verb does, but taken back
    status, sentence = refused(["render", *(run_folder if word == "RUN" else word for word in arguments)])
    assert status == 2
    assert len(sentence.splitlines()) == 1
    assert said in sentence
    assert not any(tmp_path.iterdir())


@pytest.mark.system
def test_a_library_that_is_missing_is_named_and_nothing_is_written(run_folder: Path, tmp_path: Path) -> None:
    """A name of no library: whatever this machine has, MuJoCo finds nothing to draw with."""
    done = run_to_end("render", run_folder, "--out", "film.gif", cwd=tmp_path, environment={"MUJOCO_GL": "nothing"})
    assert done.returncode == 3
    assert len(done.stderr.splitlines()) == 1
    assert "libegl1" in done.stderr
    assert not any(tmp_path.iterdir())
