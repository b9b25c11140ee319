import { existsSync } from "node:fs";
import { resolve } from "node:path";
import { defineConfig } from "vitest/config";

const here = import.meta.dirname;
const pages = ["viewer", "jobs", "job", "report", "compare", "workers", "storage"].filter((name) => existsSync(resolve(here, `${name}.html`)));

// Content security policy: no inline script, style or data: address may be emitted (assetsInlineLimit 0).
export default defineConfig({
  root: here,
  build: {
    target: "es2022",
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 900,
    rolldownOptions: { input: Object.fromEntries(pages.map((name) => [name, resolve(here, `${name}.html`)])) },
  },
  test: { include: ["src/**/*.test.ts"], environment: "node", testTimeout: 20000 },
});
