/* Elements, numbers in words. Text only ever enters the page as text. */
(function (sensorgate) {
  "use strict";

  /* h("button.sg-go", {onclick: f, disabled: true}, "Go") */
  function h(kind, properties) {
    var names = kind.split(".");
    var element = document.createElement(names[0]);
    element.className = names.slice(1).join(" ");
    Object.keys(properties || {}).forEach(function (name) {
      var value = properties[name];
      if (value === null || value === undefined || value === false) return;
      if (name.slice(0, 2) === "on") element.addEventListener(name.slice(2), value);
      else if (name in element && name !== "list" && typeof value !== "string") element[name] = value;
      else element.setAttribute(name, value === true ? "" : value);
    });
    for (var i = 2; i < arguments.length; i++) add(element, arguments[i]);
    return element;
  }

  function add(element, child) {
    if (child === null || child === undefined || child === false || child === "") return;
    if (Array.isArray(child)) child.forEach(function (each) { add(element, each); });
    else element.appendChild(child instanceof Node ? child : document.createTextNode(String(child)));
  }

  function fill(element) {
    while (element.firstChild) element.removeChild(element.firstChild);
    for (var i = 1; i < arguments.length; i++) add(element, arguments[i]);
    return element;
  }

  /* Redraw with the keyboard's place kept: elements that can be focused carry a data-key. */
  function redraw(element, children) {
    var active = document.activeElement;
    var key = active && element.contains(active) ? active.getAttribute("data-key") : null;
    fill(element, children);
    if (!key) return;
    var found = Array.prototype.filter.call(element.querySelectorAll("[data-key]"), function (each) {
      return each.getAttribute("data-key") === key;
    })[0];
    if (found) found.focus();
  }

  /* How far something is, 0 to 1. */
  function bar(share, label) {
    var percent = 100 * Math.max(0, Math.min(1, share));
    return h("div.sg-bar", {
      role: "progressbar", "aria-label": label, "aria-valuemin": "0", "aria-valuemax": "100", "aria-valuenow": String(Math.round(percent))
    }, h("div", { style: "width:" + percent.toFixed(1) + "%" }));
  }

  function count(number) {
    return Number(number).toLocaleString("en-US");
  }

  function plural(number, word) {
    return count(number) + " " + word + (number === 1 ? "" : "s");
  }

  function bytes(number) {
    var units = ["bytes", "kB", "MB", "GB", "TB"];
    var step = 0;
    while (number >= 999.5 && step < units.length - 1) { number /= 1000; step += 1; }
    return (step && number < 10 ? number.toFixed(1) : Math.round(number)) + " " + units[step];
  }

  sensorgate.dom = { h: h, fill: fill, redraw: redraw, bar: bar, count: count, plural: plural, bytes: bytes };
})(window.sensorgate);
