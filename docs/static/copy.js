"use strict";
// A button on each block of code, which copies its text.
addEventListener("DOMContentLoaded", () => {
  async function copy(text) {
    if (navigator.clipboard) return navigator.clipboard.writeText(text);
    const area = document.createElement("textarea"); // without a secure context
    area.value = text; document.body.append(area); area.select();
    document.execCommand("copy"); area.remove();
  }
  for (const block of document.querySelectorAll("div.highlight")) {
    const text = block.querySelector("pre").textContent, button = document.createElement("button");
    if (block.closest(".highlight-text")) continue; // printed, not written
    button.className = "copy"; button.type = "button"; button.textContent = "copy"; button.setAttribute("aria-label", "copy this code");
    button.addEventListener("click", async () => {
      try { await copy(text.trimEnd()); button.textContent = "copied"; } catch { button.textContent = "not copied"; }
      setTimeout(() => { button.textContent = "copy"; }, 1500);
    });
    block.append(button);
  }
});
