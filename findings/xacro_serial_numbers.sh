#!/usr/bin/env bash
# The links of a rig are named by the serial numbers of its cameras, 034422073314 as RealSense has them, in a xacro file: camera_${serial}.
# Guess: the name has the serial number as it was given. Seen with xacro 2.1.1 on 2026-11-28: a property or a macro's parameter that
# reads as a number is one. The leading zero is gone, camera_34422073314; 12e4 becomes 120000.0; both without a word. So the sensor's
# frame, which its driver names by the serial number, is in no URDF. 1_000 stays, and so does an argument named directly, $(arg serial);
# in a property it loses its zero, too. Quotes within quotes, value="'034422073314'", do not help, as values are read twice; two pairs
# of them do, and a property that holds the whole name, camera_$(arg serial).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check xacro==2.1.1
cd "$folder"
venv/bin/python - <<'PYTHON'
import xacro

SERIAL = "034422073314"
HEAD = '<robot name="car" xmlns:xacro="http://www.ros.org/wiki/xacro">'
MACRO = '<xacro:macro name="camera" params="serial"><link name="camera_${serial}"/></xacro:macro>'
ARGUMENT = '<xacro:arg name="serial" default=""/>'


def property_(value):
    return f'<xacro:property name="serial" value="{value}"/><link name="camera_${{serial}}"/>'


EXPECTED = {
    property_(SERIAL): "camera_34422073314",
    f'{MACRO}<xacro:camera serial="{SERIAL}"/>': "camera_34422073314",
    f"{ARGUMENT}{property_('$(arg serial)')}": "camera_34422073314",
    f'{ARGUMENT}<link name="camera_$(arg serial)"/>': "camera_034422073314",
    property_(f"'{SERIAL}'"): "camera_34422073314",
    property_(f"''{SERIAL}''"): "camera_034422073314",
    f'{ARGUMENT}<xacro:property name="link" value="camera_$(arg serial)"/><link name="${{link}}"/>': "camera_034422073314",
    property_("12e4"): "camera_120000.0",
    property_("1_000"): "camera_1_000",
}
for body, expected in EXPECTED.items():
    document = xacro.parse(f"{HEAD}{body}</robot>")
    xacro.process_doc(document, mappings={"serial": SERIAL})
    (link,) = document.getElementsByTagName("link")
    print(f"{body}: {link.getAttribute('name')}")
    assert link.getAttribute("name") == expected
PYTHON
