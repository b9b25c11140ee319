// Runs before the first paint: the remembered theme, so that no page flashes in the other one first.
try {
  const theme = localStorage.getItem("farfield-theme");
  if (theme === "light" || theme === "dark") document.documentElement.dataset.theme = theme;
} catch {
  // Storage may be forbidden; the system's preference then stands.
}
