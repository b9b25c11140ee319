/** The frame of every page: bar, theme, keys, connection, signing in, notes; states as in the design of the pages. */
import "../style/tokens.css";
import "../style/base.css";
import "../style/pages.css";
import "../style/operations.css";
import { explain, readSession, Refused, signIn, signOut } from "../api/client";
import type { Session } from "../api/types";
import { applyTheme, toggleTheme } from "../ui/theme";
import { h, s } from "./element";
import { clock, sentences } from "./format";
import { icon, stateMark } from "./icons";

export const main = document.getElementById("main") as HTMLElement;
const SKELETON_AFTER_MS = 300;

/** Draws the bar and asks who is there; resolves once somebody has signed in. */
export async function openPage(keys: [string, string][]): Promise<Session> {
  applyTheme();
  drawBar();
  listen(keys);
  const loading = skeleton(6);
  try {
    const session = (await readSession()) ?? (await askForKey());
    document.getElementById("sign-out")!.hidden = false;
    return session;
  } catch (error) {
    failed(main, error, "The service cannot be reached", () => location.reload());
    return new Promise(() => undefined); // nothing below can go on
  } finally {
    loading.stop();
  }
}

const NAV = [["/jobs", "Jobs"], ["/workers", "Workers"], ["/devices", "Devices"], ["/storage", "Storage"]] as const;

/** Reports and comparisons belong to jobs. */
function here(href: string): "page" | "true" | null {
  if (location.pathname === href) return "page";
  return href === "/jobs" && !NAV.some(([other]) => other === location.pathname) ? "true" : null;
}

function drawBar(): void {
  const mark = s("svg", { viewBox: "0 0 22 16", "aria-hidden": "true" }, s("path", { d: "M1 15V1l6 3v8zM10 12.5v-9l4 2v5zM17 10.6V5.4l3 1.4v2.4z", class: "mark-fill" }));
  document.getElementById("top")!.replaceChildren(
    h("a", { class: "mark", href: "/jobs" }, mark, "farfield"),
    h("nav", { "aria-label": "Main" }, ...NAV.map(([href, word]) => h("a", { href, "aria-current": here(href) }, word))),
    h("div", { class: "end" },
      h("span", { id: "line", role: "status" }),
      h("button", { id: "sign-out", class: "btn plain", type: "button", hidden: true, onclick: () => void leave() }, "Sign out"),
      h("button", { class: "theme", type: "button", "aria-label": "Light or dark", onclick: toggleTheme }, icon("theme"))),
  );
}

async function leave(): Promise<void> {
  await signOut().catch(() => undefined);
  location.reload();
}

/** What the bar says of the connection; dated while there is none. */
export function showLine(live: boolean | null, lostSinceMs = 0): void {
  const line = document.getElementById("line")!;
  if (live === null) line.replaceChildren();
  else if (live) line.replaceChildren(h("span", { class: "st ok" }, icon("done"), h("span", { class: "live-t", "aria-hidden": "true" }, "live"), h("span", { class: "sr" }, "connected, live")));
  else line.replaceChildren(h("span", { class: "st inf" }, icon("infeas"), h("span", { class: "live-t" }, `not live since ${clock(lostSinceMs)}`)));
}

function askForKey(): Promise<Session> {
  return new Promise((resolve) => {
    const input = h("input", { id: "key", type: "password", autocomplete: "current-password", spellcheck: "false", required: true, "aria-describedby": "key-help" });
    const says = h("div", { role: "alert" });
    const user = h("input", { type: "text", autocomplete: "username", hidden: true, value: "api-key", "aria-hidden": "true", tabindex: "-1" });
    const form = h("form", { class: "sign panel", "aria-labelledby": "sign-h" },
      h("header", null, h("h1", { id: "sign-h" }, "Sign in")),
      user, h("label", { for: "key" }, "API key"), input,
      h("p", { id: "key-help", class: "small q2" }, "It was printed when the service first started, and lies in the file ", h("code", null, "api-key"), " of its data folder. It is sent once, for a cookie that no script can read."),
      says, h("button", { class: "btn primary" }, "Sign in"));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      signIn({ key: input.value.trim() }).then(
        (session) => {
          main.replaceChildren();
          resolve(session);
        },
        (error: unknown) => {
          const wrong = error instanceof Refused && error.status === 401;
          says.replaceChildren(note("bad", "fail", wrong ? "This key is not valid" : "Signing in failed", explain(error).advice || explain(error).text));
          input.select();
        },
      );
    });
    main.replaceChildren(form);
    input.focus();
  });
}

/** A box that says what happened, what is kept and what to do. */
export function note(kind: string, shape: string, title: string, text: string | Node, ...actions: Node[]): HTMLElement {
  return h("div", { class: `note ${kind}` }, stateMark(kind === "idle" ? "idle" : kind, shape, title), h("p", null, text), ...actions);
}

export function failed(where: Element, error: unknown, title: string, retry?: () => void): void {
  const { text, advice } = explain(error);
  const again = retry ? [h("button", { type: "button", onclick: retry }, "Try again")] : [];
  where.replaceChildren(h("div", { role: "alert" }, note("bad", "fail", title, sentences(text, advice), ...again)));
}

/** Grey rows of the final size in an empty page, never before 300 ms. */
export function skeleton(rows: number, where: Element = main): { stop: () => void } {
  const box = h("div", { class: "sk", "aria-busy": "true", "aria-label": "Loading" }, ...Array.from({ length: rows }, () => h("i")));
  const timer = setTimeout(() => {
    if (!where.childElementCount) where.append(box);
  }, SKELETON_AFTER_MS);
  return {
    stop: () => {
      clearTimeout(timer);
      box.remove();
    },
  };
}

const actions = new Map<string, (event: KeyboardEvent) => void>();

/** Calls `act` for a key that is not typed into a field; `Escape` also there, and the arrow that leads out of a search. */
export function onKey(key: string, act: (event: KeyboardEvent) => void): void {
  actions.set(key, act);
}

function listen(keys: [string, string][]): void {
  const help = h("dialog", { "aria-labelledby": "keys-h", class: "dialog" });
  const rows = [...keys, ["T", "light or dark"], ["?", "these keys"], ["Esc", "closes"]] as [string, string][];
  help.append(h("h2", { id: "keys-h" }, "Keys"), h("dl", { class: "kv left" }, ...rows.flatMap(([key, text]) => [h("dt", null, h("kbd", null, key)), h("dd", null, text)])),
    h("form", { method: "dialog" }, h("button", null, "Close")));
  document.body.append(help);
  onKey("t", toggleTheme);
  onKey("?", () => (help.open ? help.close() : help.showModal()));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const typing = event.target instanceof HTMLElement && event.target.matches("input:not([type=radio]):not([type=checkbox]), textarea, select");
    const leaves = event.key === "Escape" || ((event.target as HTMLInputElement).type === "search" && event.key === "ArrowDown");
    if (typing && !leaves) return;
    if (document.querySelector("dialog[open]") && event.key !== "?") return;
    const act = actions.get(event.key.length === 1 ? event.key.toLowerCase() : event.key);
    if (!act) return;
    act(event);
  });
}

/** Asks before something that cannot be taken back; resolves to the answer. */
export function confirmed(title: string, text: string, yes: string, no: string): Promise<boolean> {
  return new Promise((resolve) => {
    const dialog = h("dialog", { class: "dialog", "aria-labelledby": "ask-h" },
      h("form", { method: "dialog" }, h("h2", { id: "ask-h" }, title), h("p", null, text),
        h("div", { class: "acts" }, h("button", { value: "no" }, no), h("button", { class: "btn stop", value: "yes" }, yes))));
    dialog.addEventListener("close", () => {
      resolve(dialog.returnValue === "yes");
      dialog.remove();
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}
