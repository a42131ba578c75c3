#!/usr/bin/env bash
# A map in UTM is a PCD file, binary, with x, y and z as doubles, as PCL writes such points; a scan has them as millimetres in int32; a third file has float32, a colour, and the
# pose of its sensor (VIEWPOINT: 10 m ahead, turned). A web page shows them. Where are the points?
# Guess: at their places, or at those rounded to float32, as graphics cards have them; colours as they are.
# Seen with @loaders.gl/pcd 4.4.2 (what deck.gl takes) and three 0.187.0 on 2026-11-29, without a word:
# - loaders.gl reads four bytes of each number as a float32, whatever SIZE and TYPE say: a map of northings is at (0, 1e-13, 0), 1500 mm are 2e-42, and what is below zero is NaN
# - three has the millimetres, as metres; and doubles as float32, whose steps are 0.5 m at such northings
# - three makes colours linear: red of 128 is 0.216 in place of 0.502, which is right for its own pictures, and 55 for whoever takes it times 255; loaders.gl has 32, 64, 128 for
#   128, 64, 32: red and blue change places
# - neither has the pose of the sensor: points are in its frame, and nothing says so
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit --prefix "$folder" @loaders.gl/core@4.4.2 @loaders.gl/pcd@4.4.2 @math.gl/types@4.1.0 three@0.187.0
cat > read.mjs <<'JAVASCRIPT'
import assert from "node:assert/strict";
import { parse } from "@loaders.gl/core";
import { PCDLoader as LoaderOfGl } from "@loaders.gl/pcd";
import { PCDLoader as LoaderOfThree } from "three/examples/jsm/loaders/PCDLoader.js";

/** Return what both make of a file of one point. */
async function read(fields, size, types, viewpoint, write) {
  const ones = types.map(() => 1).join(" ");
  const sizes = types.map(() => size).join(" ");
  const head = `# .PCD v0.7\nVERSION 0.7\nFIELDS ${fields}\nSIZE ${sizes}\nTYPE ${types.join(" ")}\nCOUNT ${ones}\nWIDTH 1\nHEIGHT 1\n`;
  const body = Buffer.alloc(types.length * size);
  write(body);
  const file = Buffer.concat([Buffer.from(`${head}VIEWPOINT ${viewpoint}\nPOINTS 1\nDATA binary\n`), body]);
  const bytes = new Uint8Array(file).buffer;
  const { attributes } = await parse(bytes, LoaderOfGl, { core: { worker: false } });
  const points = new LoaderOfThree().parse(bytes);
  return { gl: attributes, three: points.geometry.attributes, pose: points.position.length() };
}

const here = "0 0 0 1 0 0 0";
const map = await read("x y z", 8, ["F", "F", "F"], here, (body) => [691600.5, 5330004.654321, 500.25].forEach((metres, i) => body.writeDoubleLE(metres, 8 * i)));
console.log("doubles:", ...map.gl.POSITION.value, "by loaders.gl,", ...map.three.position.array, "by three");
assert(map.gl.POSITION.value.every((metres) => Math.abs(metres) < 1e-12));
assert.deepEqual([...map.three.position.array], [691600.5, 5330004.5, 500.25]);

const scan = await read("x y z", 4, ["I", "I", "I"], here, (body) => [1500, 2500, -3500].forEach((mm, i) => body.writeInt32LE(mm, 4 * i)));
console.log("int32:", ...scan.gl.POSITION.value, "by loaders.gl,", ...scan.three.position.array, "by three");
assert(scan.gl.POSITION.value[0] < 1e-40 && Number.isNaN(scan.gl.POSITION.value[2]));
assert.deepEqual([...scan.three.position.array], [1500, 2500, -3500]);

const coloured = await read("x y z rgb", 4, ["F", "F", "F", "U"], "10 0 0 0.7071 0 0 0.7071", (body) => {
  [1, 2, 3].forEach((metres, i) => body.writeFloatLE(metres, 4 * i));
  body.writeUInt32LE(0x804020, 12);
});
console.log("colours:", ...coloured.gl.COLOR_0.value, "by loaders.gl,", ...coloured.three.color.array, "by three");
assert.deepEqual([...coloured.gl.COLOR_0.value], [32, 64, 128]);
assert(Math.abs(coloured.three.color.array[0] - 0.2159) < 1e-3);
assert.deepEqual([[...coloured.gl.POSITION.value], [...coloured.three.position.array], coloured.pose], [[1, 2, 3], [1, 2, 3], 0]);
JAVASCRIPT
node read.mjs
