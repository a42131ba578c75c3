#!/usr/bin/env bash
# A road map (OpenDRIVE) has an origin at 48.1 degrees north, 11.5 east, by a transverse Mercator projection (`tmerc`), and a road that leads from there to the
# north-east. CARLA loads it. Where on Earth is a vehicle on that road, by the map's own function, `transform_to_geolocation`?
# Guess: where the projection of the map puts that road, to a metre. Seen with carla 0.9.16 (the client's library, without a simulator) and pyproj 3.7.2 on
# 2026-11-29, without a word:
# - SOUTH-east. A waypoint 1 km along this road has y = -478 in CARLA, whose y points to the right, and `transform_to_geolocation` takes y for north: it is 955 m off
# - with the sign turned it is 2.0 m off, and 20 m 10 km away: the projection in the file is not used but for `lat_0` and `lon_0`; it computes with a sphere
# - `+proj=utm +zone=32`, which has neither, is 42 north, 2 east, with a warning
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check carla==0.9.16 pyproj==3.7.2
cd "$folder"
venv/bin/python - <<'PYTHON'
import carla
import pyproj

PROJECTION = "+proj=tmerc +lat_0=48.1 +lon_0=11.5 +k=1 +x_0=0 +y_0=0 +ellps=WGS84 +units=m"
MAP = """<?xml version="1.0"?><OpenDRIVE>
<header revMajor="1" revMinor="4" name="" version="1" date="" north="0" south="0" east="0" west="0"><geoReference><![CDATA[{}]]></geoReference></header>
<road name="" length="20000" id="1" junction="-1">
  <planView><geometry s="0" x="0" y="0" hdg="0.5" length="20000"><line/></geometry></planView><elevationProfile/><lateralProfile/>
  <lanes><laneSection s="0"><center><lane id="0" type="none" level="false"/></center>
  <right><lane id="-1" type="driving" level="false"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane></right></laneSection></lanes>
</road></OpenDRIVE>"""

road_map = carla.Map("here", MAP.format(PROJECTION))
projection, ellipsoid = pyproj.Proj(PROJECTION), pyproj.Geod(ellps="WGS84")


def off_m(geolocation, place):
    """Return how far a geolocation is from where the projection puts a place of CARLA."""
    longitude, latitude = projection(place.x, -place.y, inverse=True)
    return ellipsoid.inv(geolocation.longitude, geolocation.latitude, longitude, latitude)[2]


for along_m, mirrored_m, turned_m in ((1000.0, 955, 2.0), (10000.0, 9581, 20)):
    place = road_map.get_waypoint_xodr(1, -1, along_m).transform.location
    geolocation = road_map.transform_to_geolocation(place)
    got_m = off_m(geolocation, place), off_m(road_map.transform_to_geolocation(carla.Location(place.x, -place.y, 0.0)), place)
    print(f"x {place.x:.0f}, y {place.y:.0f}: {geolocation.latitude:.4f} north, {geolocation.longitude:.4f} east; {got_m[0]:.0f} m off, turned {got_m[1]:.1f} m")
    assert place.y < 0 and geolocation.latitude < 48.1, (place, geolocation)
    assert abs(got_m[0] - mirrored_m) < 20 and abs(got_m[1] - turned_m) < 1, got_m
silent = carla.Map("here", MAP.format("+proj=utm +zone=32 +ellps=WGS84 +units=m")).transform_to_geolocation(carla.Location(0.0, 0.0, 0.0))
assert (silent.latitude, silent.longitude) == (42, 2), silent
PYTHON
