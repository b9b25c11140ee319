/** Elements by id, and text that is written only when it changes. Shared by all pages. */

export function byId<T extends Element = HTMLElement>(id: string): T {
  const element = document.getElementById(id);
  if (!element) throw new Error(`the page has no element ${id}`);
  return element as unknown as T;
}

export function setText(id: string, text: string): void {
  const element = byId(id);
  if (element.textContent !== text) element.textContent = text;
}

export function setShown(id: string, shown: boolean): void {
  const element = byId(id);
  if (element.hidden === shown) element.hidden = !shown;
}
