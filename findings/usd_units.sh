#!/usr/bin/env bash
# A part of a cell is a USD file in centimetres, y up, 24 time codes a second; in one second it moves by 100 of its units to the right and by 100 up. The cell is
# another file, in metres, z up, 60 time codes a second, and refers to it. Where is the part after one second, in the cell?
# Guess: at (1, 0, 1) m, as each file says what its numbers mean; or nothing of it is converted, and the part is elsewhere at another time.
# Seen with usd-core 26.11 on 2026-11-29, without a word: TIME is converted, lengths and axes are not. After one second (its time code 24, here 60) the part is
# at (100, 100, 0): 100 m away, and its "up" is the y axis of the cell. A file that says nothing is in centimetres with y up, also when everything in it is in metres.
# `UsdGeom.GetStageMetersPerUnit` and `GetStageUpAxis` tell of the file that was opened alone: whoever refers to another file has to scale and turn it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check usd-core==26.11
cd "$folder"
venv/bin/python - <<'PYTHON'
from pxr import Gf, Usd, UsdGeom

part = Usd.Stage.CreateNew("part.usda")
UsdGeom.SetStageMetersPerUnit(part, 0.01)
UsdGeom.SetStageUpAxis(part, UsdGeom.Tokens.y)
part.SetTimeCodesPerSecond(24)
cube = UsdGeom.Cube.Define(part, "/part")
position = UsdGeom.Xformable(cube).AddTranslateOp()
position.Set(Gf.Vec3d(0, 0, 0), 0)
position.Set(Gf.Vec3d(100, 100, 0), 24)
part.SetDefaultPrim(cube.GetPrim())
part.Save()

cell = Usd.Stage.CreateNew("cell.usda")
UsdGeom.SetStageMetersPerUnit(cell, 1.0)
UsdGeom.SetStageUpAxis(cell, UsdGeom.Tokens.z)
cell.SetTimeCodesPerSecond(60)
cell.DefinePrim("/cell/part").GetReferences().AddReference("part.usda")
cell.Save()

cell = Usd.Stage.Open("cell.usda")
placed = UsdGeom.Xformable(cell.GetPrimAtPath("/cell/part"))
seen = {code / 60: tuple(placed.ComputeLocalToWorldTransform(code).ExtractTranslation()) for code in (0, 30, 60)}
print("seconds and positions in the cell:", seen)
assert seen == {0.0: (0, 0, 0), 0.5: (50, 50, 0), 1.0: (100, 100, 0)}
silent = Usd.Stage.CreateInMemory()
print("a file that says nothing:", UsdGeom.GetStageMetersPerUnit(silent), "m,", UsdGeom.GetStageUpAxis(silent), "up")
assert (UsdGeom.GetStageMetersPerUnit(silent), UsdGeom.GetStageUpAxis(silent)) == (0.01, "Y")
PYTHON
