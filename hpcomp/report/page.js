"use strict";
// What a page does beyond being read. All of it can be done without: nothing is shown by it alone.
document.documentElement.classList.add("js");

addEventListener("DOMContentLoaded", () => {
  const frame = document.getElementById("compare");
  if (frame) comparison(frame, document.getElementById("split"));
  layerMap();
  document.querySelectorAll(".plot").forEach(readout);
  const copy = document.getElementById("copy");
  if (copy) copying(copy, document.getElementById("command"), document.getElementById("copied"));
});

// The range input has the keys and what assistive technology is told; pointers move it by the frame.
function comparison(frame, range) {
  const nameOf = (side) => frame.querySelector(`figure.${side}`).dataset.name;
  const show = (share) => {
    frame.style.setProperty("--split", `${share}%`);
    const before = Math.round(share);
    range.setAttribute(
      "aria-valuetext",
      `${before}% ${nameOf("before")}, ${100 - before}% ${nameOf("after")}`,
    );
  };
  const sides = ["left", "right"].map((side) => document.getElementById(side));
  if (sides[0]) choosing(frame, sides, () => show(Number(range.value)));
  const follow = (event) => {
    const box = frame.getBoundingClientRect();
    range.value = Math.min(100, Math.max(0, (100 * (event.clientX - box.left)) / box.width));
    show(Number(range.value));
  };
  frame.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    frame.setPointerCapture(event.pointerId);
    range.focus({ preventScroll: true });
    event.preventDefault();
    follow(event);
  });
  frame.addEventListener("pointermove", (event) => {
    if (frame.hasPointerCapture(event.pointerId)) follow(event);
  });
  range.addEventListener("input", () => show(Number(range.value)));
  show(Number(range.value));
}

// Which of several pictures is at which side. One picture is never at both: they change places.
function choosing(frame, sides, done) {
  const figures = [...frame.querySelectorAll("figure")];
  let chosen = [];
  const apply = (changed) => {
    if (sides[0].value === sides[1].value) {
      const other = 1 - changed;
      sides[other].value =
        chosen[changed] ?? figures.find((figure) => figure.dataset.picture !== sides[changed].value).dataset.picture;
    }
    chosen = sides.map((side) => side.value);
    for (const figure of figures) {
      figure.classList.toggle("before", figure.dataset.picture === chosen[0]);
      figure.classList.toggle("after", figure.dataset.picture === chosen[1]);
    }
    done();
  };
  sides.forEach((side, number) => side.addEventListener("change", () => apply(number)));
  apply(0); // a browser may restore what was chosen before
}

function layerMap() {
  const boxes = [...document.querySelectorAll("input[data-map]")];
  const apply = (box) => {
    document.getElementById(box.dataset.map).style.visibility = box.checked ? "" : "hidden";
  };
  for (const box of boxes) {
    box.addEventListener("change", () => apply(box));
    apply(box); // a browser may restore what was chosen before
  }
  for (const button of document.querySelectorAll("button[data-show]")) {
    button.addEventListener("click", () => {
      for (const box of boxes) {
        box.checked = button.dataset.show === "all";
        apply(box);
      }
    });
  }
}

// A chart is read bin by bin: where the pointer is, or with the arrow keys once it has the focus.
function readout(plot) {
  const bins = Number(plot.dataset.bins);
  const start = Number(plot.dataset.start);
  const shares = new Map(
    plot.dataset.shares.split(",").map((pair) => pair.split(":").map(Number)),
  );
  const along = (bin) => (((bin * 360) / bins - start + 720) % 360) / 360;
  const occupied = [...shares.keys()].sort((a, b) => along(a) - along(b));
  const line = plot.querySelector(".cursor");
  const words = plot.closest("figure").querySelector(".readout");
  let at = Math.max(0, occupied.indexOf([...shares].reduce((a, b) => (b[1] > a[1] ? b : a))[0]));

  const text = (bin) =>
    `${((bin * 360) / bins).toFixed(bins > 360 ? 1 : 0)}°: ${shares.get(bin) ?? 0}%`;
  const show = (bin) => {
    line.setAttribute("d", `M${along(bin) * 360 + start} 0v100`);
    words.textContent = text(bin);
  };
  const clear = () => {
    line.setAttribute("d", "");
    words.textContent = "";
  };
  const choose = (index) => {
    at = Math.min(occupied.length - 1, Math.max(0, index));
    plot.setAttribute("aria-valuenow", at + 1);
    plot.setAttribute("aria-valuetext", text(occupied[at]));
    return occupied[at];
  };

  plot.setAttribute("role", "slider");
  plot.setAttribute("tabindex", "0");
  plot.setAttribute("aria-valuemin", "1");
  plot.setAttribute("aria-valuemax", occupied.length);
  words.removeAttribute("aria-live"); // the slider says it
  choose(at);
  plot.addEventListener("focus", () => show(occupied[at]));
  plot.addEventListener("blur", clear);
  plot.addEventListener("keydown", (event) => {
    const to = {
      ArrowLeft: at - 1, ArrowDown: at - 1, ArrowRight: at + 1, ArrowUp: at + 1,
      PageDown: at - 10, PageUp: at + 10, Home: 0, End: occupied.length - 1,
    }[event.key];
    if (to === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    show(choose(to));
  });
  plot.addEventListener("pointermove", (event) => {
    const box = plot.getBoundingClientRect();
    const hue = start + (360 * (event.clientX - box.left)) / box.width;
    show(((Math.round((hue * bins) / 360) % bins) + bins) % bins);
  });
  plot.addEventListener("pointerleave", () =>
    document.activeElement === plot ? show(occupied[at]) : clear(),
  );
}

function copying(button, source, status) {
  button.addEventListener("click", async () => {
    let done = false;
    try {
      await navigator.clipboard.writeText(source.textContent);
      done = true;
    } catch {
      // Not allowed, or not there: the older way, which also leaves the text selected.
      getSelection().selectAllChildren(source);
      done = document.execCommand("copy");
    }
    status.textContent = done ? "Copied" : "Selected: copy it with the keyboard";
  });
}
