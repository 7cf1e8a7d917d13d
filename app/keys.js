// Keys of the whole page. In a field only Ctrl+S and Escape are taken; the rest is the field's own.
window.addEventListener("keydown", (e) => {
  const field = ["INPUT", "TEXTAREA", "SELECT"].includes(document.activeElement?.tagName || "");
  const control = e.ctrlKey || e.metaKey;
  const key = e.key.length === 1 ? e.key.toLowerCase() : e.key;
  let name = "";
  if (control && key === "s") name = "save";
  else if (e.key === "Escape") { document.activeElement?.blur?.(); name = "escape"; }
  else if (field || e.altKey) return;
  else if (control && key === "z") name = e.shiftKey ? "redo" : "undo";
  else if (control && key === "y") name = "redo";
  else if (control) return;
  else if (key === "ArrowLeft") name = e.shiftKey ? "back25" : "back";
  else if (key === "ArrowRight") name = e.shiftKey ? "on25" : "on";
  else if (key === "Home") name = "first";
  else if (key === "End") name = "last";
  else if ("12345678".includes(key)) name = "step" + key;
  else if (key === "+" || key === "=") name = "zoomin";
  else if (key === "-") name = "zoomout";
  else if (key === "0") name = "fit";
  else if (key === "b") name = "light";
  else if (key === "g") name = "grid";
  else if (key === "s") name = "snap";
  else if (key === "n") name = "next";
  else if (key === "p") name = "previous";
  else if (key === "w") name = e.shiftKey ? "worst back" : "worst";
  else if (key === "m") name = "move";
  else if (key === "d") name = "seed";
  else if (key === "x") name = "mark";
  else if (key === "Delete") name = "remove";
  else if (key === "[") name = "slower";
  else if (key === "]") name = "faster";
  // a button that was reached by keys is pressed by the space bar
  else if (key === " " && !document.activeElement?.matches?.("button:focus-visible, [role]:focus-visible")) name = "play";
  if (!name) return;
  e.preventDefault();
  e.stopImmediatePropagation();
  if (name === "save") document.activeElement?.blur?.();
  emitEvent("hall_key", name);
}, true);
window.addEventListener("beforeunload", (e) => { if (document.body.dataset.unsaved === "yes") e.preventDefault(); });
