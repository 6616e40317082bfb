// Typesets what pymdownx.arithmatex has marked: \( … \) within lines, \[ … \] on lines of their own.
document.addEventListener("DOMContentLoaded", () => {
  for (const element of document.querySelectorAll(".arithmatex")) {
    const source = element.textContent.trim();
    try {
      katex.render(source.slice(2, -2), element, { displayMode: source.startsWith("\\[") });
    } catch (error) {
      element.classList.add("katex-error"); // the source stays
      element.title = error.message;
    }
  }
});
