import { readdirSync } from "node:fs";
import { parse, resolve } from "node:path";
import { defineConfig } from "vitest/config";

const here = import.meta.dirname;
const pages = readdirSync(here).filter((file) => file.endsWith(".html"));

// Content security policy: no inline script, style or data: address may be emitted (assetsInlineLimit 0).
export default defineConfig({
  root: here,
  build: {
    target: "es2022",
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 900,
    rolldownOptions: { input: Object.fromEntries(pages.map((file) => [parse(file).name, resolve(here, file)])) },
  },
  test: { include: ["src/**/*.test.ts"], environment: "node", testTimeout: 20000 },
});
