#!/usr/bin/env bash
# A survey drone of DJI leaves pseudoranges and orbits (RINEX 3, .OBS and .NAV), and where its camera was (RTK, .MRK). gnssroute makes a trajectory of the
# pseudoranges, and corrects it with the .MRK. The drone hovers; pseudoranges are what GPS gives without any error of clocks, air or noise. Once it is near
# Munich, once near Buenos Aires. Guess: the trajectory is where the drone is, to the centimetre, corrected or not. Seen with gnssroute 0.1.1 on 2026-11-30,
# without a word:
# - of ten epochs, one a second, five are there: reading satellites goes on until the next one begins, which is the first of the NEXT epoch. That epoch is
#   lost, and its satellite counts with the one before, a second too late: 162 m from the drone near Munich, 213 m near Buenos Aires
# - without that satellite it is 24 and 29 m to the east: the Earth turns while signals travel, for 70 ms, and that is left out
# - corrected, it is right near Munich; near Buenos Aires it stays where it was, as a line of the .MRK whose latitude or longitude is negative is passed over:
#   south of the equator, and west of Greenwich, no mark is left
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check gnssroute==0.1.1 pymap3d==3.2.0 numpy==2.4.6
cat > route.py <<'PYTHON'
import contextlib
import io
import math
from pathlib import Path

import gnssroute.pipeline
import numpy as np
import pymap3d
from gnssroute.common.types import EpochObs, SatObs
from gnssroute.io.rinex_nav import read_nav
from gnssroute.positioning.satellite import EphemerisProvider
from gnssroute.positioning.spp import solve_spp

EARTH_RAD_S, MU, LIGHT_M_S, AXIS_M, TOE_S = 7.2921151467e-5, 3.986005e14, 299792458.0, 26_559_800.0, 381600
orbits = {f"G{number + 1:02d}": (0.96, number % 6 * math.pi / 3, number // 6 * math.pi / 2 + number % 6 * 0.26) for number in range(24)}


def satellite(name, tow_s):
    """Return where a satellite on a circular orbit is in the frame of the Earth of that moment, metres."""
    inclination, node, anomaly = orbits[name]
    since_s = tow_s - TOE_S
    u = anomaly + math.sqrt(MU / AXIS_M**3) * since_s
    om = node - EARTH_RAD_S * tow_s
    x, y = AXIS_M * math.cos(u), AXIS_M * math.sin(u)
    return np.array([
        x * math.cos(om) - y * math.cos(inclination) * math.sin(om),
        x * math.sin(om) + y * math.cos(inclination) * math.cos(om),
        y * math.sin(inclination),
    ])


def pseudorange_m(name, tow_s, place):
    travel_s = 0.07
    for _ in range(5):
        sent, turn = satellite(name, tow_s - travel_s), EARTH_RAD_S * travel_s
        cos, sin = math.cos(turn), math.sin(turn)
        sent = np.array([cos * sent[0] + sin * sent[1], -sin * sent[0] + cos * sent[1], sent[2]])
        travel_s = np.linalg.norm(sent - place) / LIGHT_M_S
    return travel_s * LIGHT_M_S


def write(folder, latitude, longitude, height_m):
    """Write ten epochs of a drone that hovers."""
    folder.mkdir()
    place = np.array(pymap3d.geodetic2ecef(latitude, longitude, height_m))
    header = f"{'     3.05           OBSERVATION DATA    M':<60}RINEX VERSION / TYPE\n{'G    1 C1C':<60}SYS / # / OBS TYPES\n{'':<60}END OF HEADER\n"
    marks = []
    for tick in range(10):
        tow_s = TOE_S + 600 + tick
        seen = [name for name in orbits if pymap3d.ecef2aer(*satellite(name, tow_s), latitude, longitude, height_m)[1] > 15]
        hour, rest = divmod(tow_s - 4 * 86400, 3600)
        header += f"> 2026 01 15 {hour:02d} {rest // 60:02d} {rest % 60:02d}.0000000  0{len(seen):3d}\n"
        header += "".join(f"{name}{pseudorange_m(name, tow_s, place):14.3f}\n" for name in seen)
        marks.append(f"{tick + 1}\t{tow_s:.6f}\t[2401]\t0,N\t0,E\t0,V\t{latitude:.8f},Lat\t{longitude:.8f},Lon\t{height_m:.3f},Ellh\t0.01, 0.01, 0.02\t50,Q\n")
    (folder / "flight.OBS").write_text(header)
    (folder / "flight.MRK").write_text("".join(marks))
    text = f"{'     3.05           NAVIGATION DATA     M':<60}RINEX VERSION / TYPE\n{'':<60}END OF HEADER\n"
    for name, (inclination, node, anomaly) in orbits.items():
        text += f"{name} 2026 01 15 10 00 00" + f"{0:19.12E}" * 3 + "\n"
        values = [1, 0, 0, anomaly, 0, 0, 0, math.sqrt(AXIS_M), TOE_S, 0, node, 0, inclination, 0, 0, 0, 0, 0, 2401, 0, 2, 0, 0, 1, TOE_S, 4]
        lines = [values[at : at + 4] for at in range(0, len(values), 4)]
        text += "".join("    " + "".join(f"{value:19.12E}" for value in line) + "\n" for line in lines)
    (folder / "flight.NAV").write_text(text)


def off_m(points, place):
    """Return how far east, north and up of a place points are on average."""
    return np.mean([pymap3d.geodetic2enu(point.lat, point.lon, point.height, *place) for point in points], axis=0)


for name, place, (far_m, east_m) in (("munich", (48.1, 11.5, 600.0), (162, 24)), ("buenos_aires", (-34.6, -58.4, 60.0), (213, 29))):
    write(Path(name), *place)
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        steps = gnssroute.pipeline.run_steps({"input": {"directory": name}, "optimize": {"enabled": True}})
    assert not said.getvalue()
    read = gnssroute.io.rinex_obs.read_obs(f"{name}/flight.OBS")
    ecef = np.array(pymap3d.geodetic2ecef(*place))
    right = [EpochObs(each.t, obs=[SatObs(one.prn, pseudorange_m(one.prn, each.t, ecef)) for one in each.obs[:-1]]) for each in read]
    solved_m = off_m(solve_spp(right, EphemerisProvider(read_nav(f"{name}/flight.NAV"))).points, place)
    spp_m, final_m = off_m(steps["spp"].points, place), off_m(steps["final"].points, place)
    print(f"{name}: epochs of {[each.t - TOE_S for each in read]} s; east, north, up {spp_m.round(1).tolist()} m,")
    print(f"  of epochs as they are {solved_m.round(1).tolist()} m; with {len(steps['waypoints'])} marks {final_m.round(1).tolist()} m")
    assert [each.t - TOE_S for each in read] == [600, 602, 604, 606, 608]
    assert abs(np.linalg.norm(spp_m) - far_m) < 1
    assert np.allclose(solved_m, [east_m, 0, 0], atol=1.5)
    if name == "munich":
        assert len(steps["waypoints"]) == 10
        assert np.abs(final_m).max() < 0.01
    else:
        assert not steps["waypoints"]
        assert np.allclose(final_m, spp_m)
PYTHON
venv/bin/python route.py
