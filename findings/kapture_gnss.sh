#!/usr/bin/env bash
# Where a survey's pictures were taken is brought into a kapture dataset (Naver's format for localisation, with converters): from the EXIF of the pictures, taken in Boston and
# in Rio, and from the sentences of a receiver (NMEA) around midnight, in each second GGA before RMC, as most send them. And it is written back into the EXIF.
# Guess: latitudes south and longitudes west are negative; times are those of the sentences.
# Seen with kapture 1.1.10 and piexif 1.1.3 on 2026-11-30, without a word:
# - Boston is in Central Asia, Rio in Arabia: signs are gone, as letters are read as bytes and compared with text. Written back, every latitude is "E", every
#   longitude "N", and every height below the sea
# - the fix at midnight is a day early, as GGA gets the date of the last RMC
# - 00:00:00.5000 is 00:00:05, as its four digits are taken for milliseconds; with two or three digits it is right
# - a position of which its sentence says that there is no fix (quality 0) is one like any other; sentences of receivers for more than GPS ($GN…) are passed over
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 numpy-quaternion==2024.0.13 numba==0.68.1 scipy==1.17.1 piexif==1.1.3 pillow==13.0.0 pytz==2026.6 tqdm==4.70.1 \
  pyyaml==6.0.4 requests matplotlib wcmatch tabulate
venv/bin/pip install --quiet --disable-pip-version-check --no-deps kapture==1.1.10
cat >locate.py <<'PYTHON'
import kapture
import piexif
from kapture.converter.exif.export_exif import gps_record_to_exif_dict, update_exif
from kapture.converter.exif.import_exif import convert_gps_to_kapture_record, read_exif
from kapture.converter.nmea.import_nmea import extract_gnss_from_nmea
from PIL import Image

TAGS = piexif.GPSIFD


def sexagesimal(degrees):
    minutes = round(abs(degrees) * 60)
    return (minutes // 60, 1), (minutes % 60, 1), (0, 1)


for name, latitude, longitude in (("Boston", 42.35, -71.05), ("Rio", -22.9, -43.2)):
    gps = {
        TAGS.GPSLatitudeRef: "N" if latitude > 0 else "S",
        TAGS.GPSLatitude: sexagesimal(latitude),
        TAGS.GPSLongitudeRef: "E" if longitude > 0 else "W",
        TAGS.GPSLongitude: sexagesimal(longitude),
        TAGS.GPSAltitudeRef: 0,
        TAGS.GPSAltitude: (500, 1),
        TAGS.GPSDOP: (1, 1),
    }
    Image.new("RGB", (8, 8)).save("picture.jpg", exif=piexif.dump({"GPS": gps}))
    record = convert_gps_to_kapture_record(read_exif("picture.jpg"))
    update_exif("picture.jpg", gps_record_to_exif_dict(kapture.RecordGnss(x=longitude, y=latitude, z=500.0, utc=0, dop=1.0)))
    with Image.open("picture.jpg") as picture:
        written = picture.getexif().get_ifd(0x8825)
    letters = written[TAGS.GPSLatitudeRef], written[TAGS.GPSLongitudeRef], written[TAGS.GPSAltitudeRef]
    print(f"{name}, at {latitude}, {longitude}: read as {record.y:.2f}, {record.x:.2f}; written with {letters}")
    assert abs(record.y - abs(latitude)) < 1e-3 and abs(record.x - abs(longitude)) < 1e-3
    assert letters == ("E", "N", b"\x01")

PLACE, DATE = "4806.0000,N,01130.0000,E", {0: "141123", 1: "151123"}
MIDNIGHT_NS = 1_700_006_400 * 10**9
lines = ["$GPRMC,235958.00,A,4806.0000,N,01130.0000,E,0.0,0.0,141123,,,A*00"]
for day, time, system, quality in ((0, "235959.00", "GP", 1), (1, "000000.00", "GP", 1), (1, "000000.5000", "GP", 1), (1, "000001.00", "GN", 1), (1, "000002.00", "GP", 0)):
    lines.append(f"${system}GGA,{time},{PLACE},{quality},09,0.8,500.0,M,46.0,M,,*00")
    lines.append(f"$GPRMC,{time},A,{PLACE},0.0,0.0,{DATE[day]},,,A*00")
with open("nmea.txt", "w") as file:
    file.write("\n".join(lines) + "\n")
_, records = extract_gnss_from_nmea("nmea.txt")
seconds = [(time_ns - MIDNIGHT_NS) / 1e9 for time_ns, _, _ in kapture.flatten(records)]
print("fixes at -1, 0, 0.5, 1 ($GN…) and 2 s (no fix) after midnight are at", seconds, "s")
assert seconds == [-1.0, -86_400.0, 5.0, 2.0]
PYTHON
venv/bin/python -W ignore locate.py
