/** The toolbar, the keys that press it, and the divider of the swipe: each to a switch of the running viewer. */
import { byId, setShown } from "../ui/dom";
import { toggleTheme } from "../ui/theme";
import type { App } from "./app";
import type { Modes } from "./engine";
import { readHeat } from "./heat";

const TOGGLES: Record<string, keyof Modes> = {
  "t-impostors": "impostors", "t-split": "split", "t-beside": "beside", "t-layers": "layers", "t-heat": "heat", "t-cells": "cells", "t-freeze": "freeze",
};
const KEYS: Record<string, string> = {
  i: "t-impostors", x: "t-split", b: "t-beside", e: "t-difference", l: "t-layers", m: "t-heat", c: "t-cells", f: "t-freeze", g: "t-fly", r: "b-record",
  p: "b-replay", y: "b-link",
};

/** Shows which switches are on. */
export function showToolbar({ engine, walker, difference }: App): void {
  for (const [id, mode] of Object.entries(TOGGLES)) byId<HTMLInputElement>(id).checked = Boolean(engine.modes[mode]);
  byId<HTMLInputElement>("t-fly").checked = walker.free;
  byId<HTMLInputElement>("t-difference").checked = difference.on;
}

/** Whether the key means something here. */
export function pressKey(app: App, key: string): boolean {
  if (KEYS[key]) {
    byId<HTMLInputElement>(KEYS[key]).click();
  } else if (key >= "1" && key <= "9") {
    return app.worst.open(Number(key) - 1);
  } else if (key === "Enter" && document.activeElement === app.canvas) {
    app.pick(0.5, 0.5);
  } else if (key === "h") {
    const hidden = Boolean(byId("main").querySelector<HTMLElement>(".overlay")!.hidden);
    app.setMode({ overlay: hidden });
  } else if (key === "t") {
    byId("b-theme").click();
  } else if (key === "?") {
    byId("b-keys").click();
  } else if (key === "Escape") {
    setShown("keys", false);
    byId("b-keys").setAttribute("aria-expanded", "false");
  } else {
    return false;
  }
  return true;
}

export function connectToolbar(app: App): void {
  for (const [id, mode] of Object.entries(TOGGLES)) {
    byId<HTMLInputElement>(id).addEventListener("change", (e) => app.setMode({ [mode]: (e.target as HTMLInputElement).checked }));
  }
  byId<HTMLInputElement>("t-fly").addEventListener("change", (e) => app.setMode({ free: (e.target as HTMLInputElement).checked }));
  byId<HTMLInputElement>("t-difference").addEventListener("change", (e) => app.setMode({ difference: (e.target as HTMLInputElement).checked }));
  byId("b-link").addEventListener("click", () => void app.copyLink());
  byId("b-theme").addEventListener("click", () => {
    toggleTheme();
    app.engine.setHeat(readHeat());
    app.touch(); // the difference has the theme's colours
  });
  byId("b-keys").addEventListener("click", () => {
    const shown = Boolean(byId("keys").hidden);
    setShown("keys", shown);
    byId("b-keys").setAttribute("aria-expanded", String(shown));
  });
  byId("notice-button").addEventListener("click", () => location.reload());
  const split = byId("split");
  const move = (at: number): void => app.setMode({ splitAt: Math.max(0.02, Math.min(0.98, at)) });
  split.addEventListener("pointerdown", (e) => split.setPointerCapture(e.pointerId));
  split.addEventListener("pointermove", (e) => {
    if (!split.hasPointerCapture(e.pointerId)) return;
    const r = app.canvas.getBoundingClientRect();
    move((e.clientX - r.left) / r.width);
  });
  split.addEventListener("keydown", (e) => {
    if (e.key !== "ArrowLeft" && e.key !== "ArrowRight") return;
    e.stopPropagation();
    e.preventDefault();
    move(app.engine.modes.splitAt + (e.key === "ArrowLeft" ? -0.01 : 0.01));
  });
}
