// Colours of drawings by their names, for a light and a dark page.
const PALETTES = {
  light: { true: "#1f5fa8", estimated: "#e0761a", grey: "#8b95a1", ink: "#27313b", third: "#2a9d8f", fourth: "#8e5ea2",
           fifth: "#b3261e", sixth: "#6b7a2a", ok: "#2a9d8f", degraded: "#e9b949", lost: "#d64a3f", paper: "#ffffff",
           ground: "#f4f6f8", road: "#e3e7eb", swept: "rgba(31,95,168,.16)", line: "#dfe4e8", soft: "#5b6673",
           ice: [125, 74, 168], sky: "#e9eff5" },
  dark: { true: "#6ea8e8", estimated: "#f29a4b", grey: "#8b95a1", ink: "#e4e9ee", third: "#4cc3b3", fourth: "#bd92d1",
          fifth: "#ef7067", sixth: "#b1c25a", ok: "#4cc3b3", degraded: "#e9b949", lost: "#ef7067", paper: "#1a2129",
          ground: "#12171d", road: "#29323c", swept: "rgba(110,168,232,.17)", line: "#333d48", soft: "#9aa6b2",
          ice: [170, 120, 214], sky: "#161c23" },
};

function isDark() {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

const palette = () => PALETTES[isDark() ? "dark" : "light"];
