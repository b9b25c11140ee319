/** Elements from code, without inline styles or markup in strings: both would need a weaker content security policy. */

type Child = Node | string | number | null | undefined | false;
type Props = Record<string, unknown>;

const SVG = "http://www.w3.org/2000/svg";

/** `on…` is a listener, a boolean switches an attribute, `css` sets properties through the CSSOM. */
export function h<K extends keyof HTMLElementTagNameMap>(tag: K, props?: Props | null, ...children: Child[]): HTMLElementTagNameMap[K];
export function h(tag: string, props?: Props | null, ...children: Child[]): HTMLElement {
  return fill(document.createElement(tag), props, children);
}

export function s<K extends keyof SVGElementTagNameMap>(tag: K, props?: Props | null, ...children: Child[]): SVGElementTagNameMap[K] {
  return fill(document.createElementNS(SVG, tag), props, children);
}

function fill<E extends HTMLElement | SVGElement>(element: E, props: Props | null | undefined, children: Child[]): E {
  for (const [name, value] of Object.entries(props ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value as EventListener);
    else if (name === "css") for (const [k, v] of Object.entries(value as Record<string, string>)) element.style.setProperty(k, v);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.filter((c): c is Node | string | number => c !== null && c !== undefined && c !== false).map((c) => (typeof c === "number" ? String(c) : c)));
  return element;
}

/** Sets what an element holds; does nothing where `key` is what it was set with last, so that focus and selection stay. */
export function refill(element: Element, key: string, make: () => Child[]): void {
  const held = element as Element & { filledWith?: string };
  if (held.filledWith === key) return;
  held.filledWith = key;
  element.replaceChildren(...make().filter((c): c is Node | string => c !== null && c !== undefined && c !== false && typeof c !== "number"));
}

/** Holds what may be wider than the page; the keyboard reaches it for as long as it has something to scroll. */
export function scroller(held: HTMLElement): HTMLElement {
  const box = h("div", { class: "scroll" }, held);
  const name = held.querySelector("caption")?.textContent ?? "";
  const watch = new ResizeObserver(() => {
    if (box.scrollWidth > box.clientWidth) for (const [key, value] of [["tabindex", "0"], ["role", "region"], ["aria-label", name]]) box.setAttribute(key, value);
    else for (const key of ["tabindex", "role", "aria-label"]) box.removeAttribute(key);
  });
  watch.observe(box);
  watch.observe(held);
  return box;
}
