// SPDX-License-Identifier: Apache-2.0
// The size of what a browser loads; `npm run build` comes first.
import assert from "node:assert/strict";
import { readdir, readFile } from "node:fs/promises";
import { test } from "node:test";
import { gunzipSync } from "node:zlib";

const DIST = new URL("../dist/", import.meta.url);
const MAX_BYTES = 300_000;

test("the page is at most 300 kB, compressed", async (context) => {
  const names = ["app.css", "app.js", "index.html", "licenses.txt"];
  assert.deepEqual((await readdir(DIST)).sort(), names.flatMap((name) => [name, `${name}.gz`]));
  let total = 0;
  for (const name of names) {
    const compressed = await readFile(new URL(`${name}.gz`, DIST));
    assert.deepEqual(gunzipSync(compressed), await readFile(new URL(name, DIST)));
    total += compressed.length;
  }
  context.diagnostic(`${total} bytes, compressed`);
  assert.ok(total <= MAX_BYTES, `${total} bytes`);
});

test("the page names no other address, and has no inline style or script", async () => {
  const html = await readFile(new URL("index.html", DIST), "utf8");
  assert.doesNotMatch(html, /https?:|style=|<style|\son\w+=|<script(?![^>]*src="app\.js")/);
  assert.doesNotMatch(await readFile(new URL("app.css", DIST), "utf8"), /url\(|@import/);
});

test("the licences of the bundled packages are listed", async () => {
  const text = await readFile(new URL("licenses.txt", DIST), "utf8");
  for (const name of ["three 0", "uplot 1"]) assert.match(text, new RegExp(`== ${name}\\..*MIT ==`));
  assert.match(text, /Permission is hereby granted/);
});
