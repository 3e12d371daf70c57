// What one takes from a page: the picture as a file, texts to copy, and the whole screen for it.

import { at, make } from "./elements.js";

export function saveFile(bytes, name, type = "image/png") {
  const link = make("a", { href: URL.createObjectURL(new Blob([bytes], { type })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

// Copy the text of an element: where the page may not write to the clipboard, the text is selected.
export async function copy(button, element) {
  const before = button.dataset.before ??= button.textContent;
  try {
    await navigator.clipboard.writeText(element.textContent);
    button.textContent = "Copied";
  } catch {
    getSelection().selectAllChildren(element);
    button.textContent = "Selected";
  }
  setTimeout(() => { button.textContent = before; }, 1500);
}

// A text with its name and a button that copies it.
export function copied(title, text, rows = "") {
  const body = make("pre", { tabindex: "0", class: rows }, text);
  const button = make("button", { type: "button", "aria-label": `Copy: ${title}`, onclick: () => copy(button, body) }, "Copy");
  return make("div", { class: "saved" }, make("div", { class: "row" }, make("span", {}, title), button), body);
}

export function fullScreen() {
  if (document.fullscreenElement) return document.exitFullscreen();
  return at("frame").requestFullscreen();
}
