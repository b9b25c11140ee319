// Turns a login link (/open#login=TOKEN&to=/viewer/NAME) or a typed key into a session, then goes to the target.
// The token is taken out of the address, and so out of the history, before anything else happens.

const given = new URLSearchParams(location.hash.slice(1));
history.replaceState(null, "", location.pathname);
const to = given.get("to") ?? "";
// Only a path on this host, and a view in it: "//host" or "/\host" would lead elsewhere.
const target = /^\/[A-Za-z0-9._~-][A-Za-z0-9._~/-]*(#[A-Za-z0-9=&,.+-]*)?$/.test(to) ? to : "/jobs";
const says = document.getElementById("says");
const form = document.getElementById("form");

async function start(opening) {
  const answer = await fetch("/v1/session", {
    method: "POST",
    headers: { "content-type": "application/json" },
    body: JSON.stringify(opening),
  });
  if (answer.ok) await forgetFiles();
  return answer.ok;
}

// What the viewer kept for another session (webviewer/src/stream/kept.ts).
async function forgetFiles() {
  const names = globalThis.caches ? await caches.keys() : [];
  for (const name of names) if (name.startsWith("farfield placement ")) await caches.delete(name);
}

function ask(text) {
  says.textContent = text;
  form.hidden = false;
  document.getElementById("key").focus();
}

form.addEventListener("submit", async (event) => {
  event.preventDefault();
  if (await start({ key: document.getElementById("key").value.trim() })) location.replace(target);
  else ask("This key is not valid.");
});

const login = given.get("login");
if (login !== null && (await start({ login }))) location.replace(target);
else if ((await fetch("/v1/session")).ok) location.replace(target);
else ask(login === null ? "Enter your key to go on." : "This link was used before. Enter your key to go on.");
