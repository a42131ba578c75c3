"""Files of lidar and radar: read back by ourselves, and by the reader that users have."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.assets.lidar_file import lidar_bytes, read_lidar_file
from bagassets.assets.radar_file import FIELDS, radar_bytes, read_radar_file
from bagassets.base.errors import DatasetError

DEVKIT = Path(
    os.environ.get("BAGASSETS_DEVKIT_PYTHON", Path(__file__).parents[2] / ".devkit-venv/bin/python")
)

READ_WITH_DEVKIT = """
import json, sys
import numpy as np
from nuscenes.utils.data_classes import LidarPointCloud, RadarPointCloud
found = {}
for name in sys.argv[1:]:
    kind = LidarPointCloud if name.endswith(".bin") else RadarPointCloud
    cloud = kind.from_file(name)
    cloud.remove_close(1e-9)  # what from_file_multisweep does with every sweep
    cloud.transform(np.eye(4))
    found[name] = cloud.points.tolist()
print(json.dumps(found))
"""


def read_with_devkit(*paths: Path) -> dict[str, list[list[float]]]:
    """What nuscenes-devkit, with its default filters, makes of each file: field by field."""
    command = [str(DEVKIT), "-c", READ_WITH_DEVKIT, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{DEVKIT} (make devkit): {done.stderr}"
    return {Path(name).name: points for name, points in json.loads(done.stdout).items()}


# --- lidar ----------------------------------------------------------------------------------


def test_lidar_points_are_rows_of_five_little_endian_floats(tmp_path):
    points = np.arange(15, dtype=np.float32).reshape(3, 5)
    data = lidar_bytes(points)
    assert bytes(data) == points.astype("<f4").tobytes()
    (tmp_path / "a.pcd.bin").write_bytes(data)
    assert np.array_equal(read_lidar_file(tmp_path / "a.pcd.bin"), points)


def test_lidar_points_of_another_shape_are_refused():
    with pytest.raises(ValueError, match="shape"):
        lidar_bytes(np.zeros((3, 4), np.float32))


def test_strided_lidar_points_are_written_in_order():
    points = np.arange(30, dtype=np.float32).reshape(6, 5)[::2]
    assert bytes(lidar_bytes(points)) == points.tobytes()


def test_a_torn_lidar_file_is_refused(tmp_path):
    (tmp_path / "a.pcd.bin").write_bytes(bytes(24))
    with pytest.raises(DatasetError, match=r"a\.pcd\.bin"):
        read_lidar_file(tmp_path / "a.pcd.bin")


def test_an_empty_lidar_file_has_no_points(tmp_path):
    (tmp_path / "a.pcd.bin").write_bytes(b"")
    assert read_lidar_file(tmp_path / "a.pcd.bin").shape == (0, 5)


# --- radar ----------------------------------------------------------------------------------

NUMBER = st.floats(-300, 300, width=32)
STATES = {"dyn_prop": (0, 6), "is_quality_valid": (0, 1), "x_rms": (0, 31), "y_rms": (0, 31), "pdh0": (0, 7),
          "vx_rms": (0, 31), "vy_rms": (0, 31), "id": (0, 32_767)}  # fmt: skip
OPTIONAL = [name for name in FIELDS if name not in ("x", "y", "ambig_state", "invalid_state")]


@st.composite
def radar_targets(draw):
    number = draw(st.integers(1, 6))
    names = ["x", "y", *draw(st.lists(st.sampled_from(OPTIONAL), unique=True))]
    kinds = {name: st.integers(*STATES[name]) if name in STATES else NUMBER for name in names}
    return {name: np.array([float(draw(kinds[name])) for _ in range(number)]) for name in names}


@settings(max_examples=60, deadline=None)
@given(radar_targets())
def test_radar_targets_come_back(tmp_path_factory, targets):
    path = tmp_path_factory.mktemp("radar") / "a.pcd"
    path.write_bytes(radar_bytes(targets))
    table = read_radar_file(path)
    assert table.dtype.names == FIELDS
    for name, values in targets.items():
        assert np.array_equal(table[name].astype(float), values)


def test_the_header_is_that_of_nuscenes():
    data = radar_bytes({"x": np.zeros(2), "y": np.zeros(2)})
    head = data[: data.index(b"DATA")].decode().splitlines()
    assert head == [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        (
            "FIELDS x y z dyn_prop id rcs vx vy vx_comp vy_comp is_quality_valid ambig_state x_rms y_rms "
            "invalid_state pdh0 vx_rms vy_rms"
        ),
        "SIZE 4 4 4 1 2 4 4 4 4 4 1 1 1 1 1 1 1 1",
        "TYPE F F F I I F F F F F I I I I I I I I",
        "COUNT " + " ".join("1" * 18),
        "WIDTH 2",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        "POINTS 2",
    ]
    assert len(data[data.index(b"DATA binary\n") + 12 :]) == 2 * 43 + 1


def test_numbers_that_do_not_fit_are_limited():
    targets = {"x": np.array([1.0]), "y": np.array([2.0]), "x_rms": np.array([1e6]), "rcs": np.array([1e300]),
               "id": np.array([40_000.0]), "vx": np.array([np.nan])}  # fmt: skip
    table = np.frombuffer(radar_bytes(targets).partition(b"DATA binary\n")[2][:43], read_dtype())
    assert table["x_rms"] == 127
    assert table["id"] == 40_000 - 32_768
    assert np.isfinite(table["rcs"])
    assert table["vx"] == 0


def read_dtype():
    kinds = ["<f4"] * 3 + ["i1", "<i2"] + ["<f4"] * 5 + ["i1"] * 8
    return np.dtype(list(zip(FIELDS, kinds, strict=True)))


def test_velocities_as_measured_stand_in_for_compensated_ones(tmp_path):
    path = tmp_path / "a.pcd"
    path.write_bytes(
        radar_bytes({"x": np.ones(1), "y": np.ones(1), "vx": np.array([3.0]), "vy": np.array([4.0])})
    )
    assert read_radar_file(path)[["vx_comp", "vy_comp"]].tolist() == [(3.0, 4.0)]


@pytest.mark.parametrize(
    "targets", [{"x": np.zeros(1)}, {"x": np.zeros(1), "y": np.zeros(1), "speed": np.zeros(1)}]
)
def test_fields_that_the_format_does_not_have_are_refused(targets):
    with pytest.raises(ValueError, match="x and y"):
        radar_bytes(targets)


def test_a_torn_radar_file_is_refused(tmp_path):
    path = tmp_path / "a.pcd"
    whole = radar_bytes({"x": np.zeros(3), "y": np.zeros(3)})
    for torn in (whole[:-30], whole[:100], b""):
        path.write_bytes(torn)
        with pytest.raises(DatasetError, match=r"a\.pcd"):
            read_radar_file(path)


@pytest.mark.devkit
def test_the_devkit_reads_every_point_and_every_target(tmp_path):
    rng = np.random.default_rng(3)
    points = rng.normal(size=(50, 5)).astype(np.float32) * 20
    (tmp_path / "lidar.pcd.bin").write_bytes(lidar_bytes(points))
    for number in (1, 2, 50):
        targets = {name: rng.normal(size=number) * 20 for name in ("x", "y", "z", "rcs", "vx", "vy")}
        (tmp_path / f"radar{number}.pcd").write_bytes(radar_bytes(targets))
    bare = {"x": np.array([5.0, 7.0]), "y": np.array([1.0, 2.0])}
    (tmp_path / "bare.pcd").write_bytes(radar_bytes(bare))
    # A number that is not finite must not make the first target the sign of an empty file.
    unknown = {"x": np.array([5.0, 7.0]), "y": np.array([1.0, 2.0]), "rcs": np.array([np.nan, np.inf])}
    (tmp_path / "unknown.pcd").write_bytes(radar_bytes(unknown))
    nothing = {"x": np.zeros(0), "y": np.zeros(0)}
    (tmp_path / "nothing.pcd").write_bytes(radar_bytes(nothing))
    invalid = bare | {"invalid_state": np.array([0.0, 1.0])}
    (tmp_path / "invalid.pcd").write_bytes(radar_bytes(invalid))

    found = read_with_devkit(*sorted(tmp_path.iterdir()))

    assert np.allclose(np.array(found["lidar.pcd.bin"]), points[:, :4].T, atol=1e-5)
    for number in (1, 2, 50):
        ours = read_radar_file(tmp_path / f"radar{number}.pcd")
        theirs = np.array(found[f"radar{number}.pcd"])
        assert theirs.shape == (18, number)
        for row, name in enumerate(FIELDS):
            assert np.array_equal(theirs[row], ours[name].astype(float)), name
    assert found["bare.pcd"][:2] == [[5.0, 7.0], [1.0, 2.0]]
    assert found["unknown.pcd"][:2] == [[5.0, 7.0], [1.0, 2.0]]
    assert np.array(found["nothing.pcd"]).shape == (18, 0)
    assert found["invalid.pcd"][0] == [5.0]  # recorded states keep their meaning
    assert len(read_radar_file(tmp_path / "nothing.pcd")) == 0
