// SPDX-License-Identifier: Apache-2.0
// Bundles the page: dist/{index.html,app.js,app.css,licenses.txt}, each of them also with the ending .gz, compressed. `--tests` bundles
// the unit tests instead, into build-tests/.
import { build } from "esbuild";
import { copyFile, mkdir, readdir, readFile, rm, writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";

const root = dirname(fileURLToPath(import.meta.url));
const common = { absWorkingDir: root, bundle: true, format: "esm", target: "es2022", logLevel: "warning" };

async function buildTests() {
  const files = (await readdir(join(root, "test"))).filter((name) => name.endsWith(".test.mjs"));
  await rm(join(root, "build-tests"), { recursive: true, force: true });
  await build({
    ...common,
    entryPoints: files.map((name) => `test/${name}`),
    platform: "node",
    outdir: "build-tests",
    outExtension: { ".js": ".mjs" },
    entryNames: "[name]",
  });
}

/** The licence texts of the packages of which the bundle has code. */
async function licences(inputs) {
  const names = new Set();
  for (const path of inputs) {
    const match = /node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(path);
    if (match) names.add(match[1]);
  }
  let text = "The page of evpose view contains code of these packages.\n";
  for (const name of [...names].sort()) {
    const folder = join(root, "node_modules", name);
    const { version, license } = JSON.parse(await readFile(join(folder, "package.json"), "utf8"));
    const file = (await readdir(folder)).find((entry) => /^licen[cs]e(\.|$)/i.test(entry));
    if (!file) throw new Error(`the package ${name} has no licence file: add its licence here before bundling it`);
    text += `\n== ${name} ${version}, ${license} ==\n\n${(await readFile(join(folder, file), "utf8")).trim()}\n`;
  }
  return text;
}

async function buildPage() {
  const dist = join(root, "dist");
  await rm(dist, { recursive: true, force: true });
  await mkdir(dist, { recursive: true });
  const result = await build({
    ...common,
    entryPoints: { app: "src/main.ts" },
    outdir: "dist",
    minify: true,
    metafile: true,
    legalComments: "none",
  });
  await copyFile(join(root, "src/index.html"), join(dist, "index.html"));
  await writeFile(join(dist, "licenses.txt"), await licences(Object.keys(result.metafile.inputs)));
  for (const name of await readdir(dist)) {
    await writeFile(join(dist, `${name}.gz`), gzipSync(await readFile(join(dist, name)), { level: 9 }));
  }
}

await (process.argv.includes("--tests") ? buildTests() : buildPage());
