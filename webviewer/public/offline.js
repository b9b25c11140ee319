// The viewer's own page and scripts, kept for when the service cannot be reached. Nothing that belongs to anybody is kept here:
// files of placements are the page's business (src/stream/kept.ts). Scope: /viewer/.
const NAME = "farfield viewer";
const PAGE = "/viewer/"; // one page for all placements

const isPage = (url) => /^\/viewer\/[^/]+\/?$/.test(url.pathname);
const isBuilt = (url) => url.pathname.startsWith("/assets/"); // named by digest: never changes
const isPlain = (url) => url.pathname === "/theme.js" || url.pathname === "/icon.svg";

/** From the service, else as it was kept. Another page than the kept one means another build: that one's files go. */
async function fromService(request, key) {
  const cache = await caches.open(NAME);
  let answer;
  try {
    answer = await fetch(request);
  } catch (error) {
    const kept = await cache.match(key);
    if (kept) return kept;
    throw error;
  }
  if (answer.ok && !answer.redirected) {
    const copy = answer.clone();
    if (key === PAGE) {
      const before = await cache.match(PAGE);
      if (before && (await before.text()) !== (await answer.clone().text())) for (const old of await cache.keys()) await cache.delete(old);
    }
    await cache.put(key, copy);
  }
  return answer;
}

async function built(request) {
  const cache = await caches.open(NAME);
  const kept = await cache.match(request.url);
  if (kept) return kept;
  const answer = await fetch(request);
  if (answer.ok) await cache.put(request.url, answer.clone());
  return answer;
}

/** What a page had loaded before this worker was there. */
async function keep(addresses) {
  const cache = await caches.open(NAME);
  for (const address of addresses) {
    const url = new URL(address);
    if (url.origin !== location.origin) continue;
    const key = isPage(url) ? PAGE : isBuilt(url) || isPlain(url) ? url.href : null;
    if (key && !(await cache.match(key))) await (isBuilt(url) ? built(new Request(key)) : fromService(new Request(url.href), key));
  }
}

addEventListener("install", () => skipWaiting());
addEventListener("activate", (event) => event.waitUntil(clients.claim()));
addEventListener("message", (event) => event.waitUntil(keep(event.data)));
addEventListener("fetch", (event) => {
  const { request } = event;
  const url = new URL(request.url);
  if (request.method !== "GET" || url.origin !== location.origin) return;
  if (request.mode === "navigate" && isPage(url)) event.respondWith(fromService(request, PAGE));
  else if (isBuilt(url)) event.respondWith(built(request));
  else if (isPlain(url)) event.respondWith(fromService(request, url.href));
});
