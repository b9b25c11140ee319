// Takes the "funding" addresses out of package-lock.json, so that the lock file names no host at all.
import { readFileSync, writeFileSync } from "node:fs";

const path = new URL("../package-lock.json", import.meta.url);
const lock = JSON.parse(readFileSync(path, "utf8"));
for (const entry of Object.values(lock.packages)) delete entry.funding;
const text = JSON.stringify(lock, null, 2) + "\n";
const left = text.match(/https?:[^"]*/);
if (left) throw new Error(`package-lock.json still names ${left[0]}`);
writeFileSync(path, text);
