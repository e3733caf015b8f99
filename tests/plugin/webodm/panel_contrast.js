/* Texts that are hard to read: [text, contrast] of every visible text in `selector` with less than `least` against
   what lies behind it, by the formula of WCAG 2.1. */
(function (selector, least) {
  "use strict";
  function parse(color) {
    var parts = /rgba?\(([^)]*)\)/.exec(color)[1].split(/[ ,/]+/).map(Number);
    return { rgb: parts.slice(0, 3), alpha: parts.length > 3 ? parts[3] : 1 };
  }
  function over(top, bottom, alpha) {
    return top.map(function (value, i) { return alpha * value + (1 - alpha) * bottom[i]; });
  }
  function chain(element) {
    return element ? chain(element.parentElement).concat([element]) : [];
  }
  function luminance(rgb) {
    var linear = rgb.map(function (value) {
      value /= 255;
      return value <= 0.03928 ? value / 12.92 : Math.pow((value + 0.055) / 1.055, 2.4);
    });
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
  }
  var found = [];
  var walker = document.createTreeWalker(document.querySelector(selector), NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    var parent = walker.currentNode.parentElement, text = walker.currentNode.nodeValue.trim();
    if (!text || !parent.getClientRects().length || parent.closest("[disabled], option, [aria-hidden]")) continue;
    var back = [255, 255, 255], opacity = 1;
    chain(parent).forEach(function (element) {
      var style = getComputedStyle(element), color = parse(style.backgroundColor);
      back = over(color.rgb, back, color.alpha);
      opacity *= Number(style.opacity);
    });
    var front = parse(getComputedStyle(parent).color);
    var a = luminance(over(front.rgb, back, front.alpha * opacity)), b = luminance(back);
    var contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    // Buttons and links have the theme's own colours.
    if (contrast < least && !parent.closest(".btn, a")) found.push([text.slice(0, 60), contrast]);
  }
  return found;
})
