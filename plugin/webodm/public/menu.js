/* The page Camera check: what is changed there goes to the plugin's API. */
(function (sensorgate) {
  "use strict";

  var page = document.getElementById("sg-page"), said = document.getElementById("sg-said");
  var sheet = document.getElementById("sg-sheet"), thresholds = document.getElementById("sg-thresholds");

  /* `reload`: what was changed stands in other places of the page, too. */
  function save(change, reload) {
    said.textContent = "Saving…";
    sensorgate.requests.send("POST", page.getAttribute("data-api"), { json: change }).then(function () {
      said.textContent = "Saved.";
      if (reload) window.location.reload();
    }, function (error) {
      said.textContent = error.message;
      said.scrollIntoView({ block: "center" });
    });
  }

  function sheetScope() {
    return sheet.elements.all && sheet.elements.all.checked ? "all" : "mine";
  }

  document.getElementById("sg-hold").addEventListener("submit", function (event) {
    event.preventDefault();
    save({ hold: event.target.elements.hold.value });
  });

  sheet.addEventListener("submit", function (event) {
    event.preventDefault();
    var file = sheet.querySelector("input[type=file]").files[0];
    if (!file) {
      said.textContent = "Choose a file first.";
      return;
    }
    file.text().then(function (text) {
      save({ sheet: { name: file.name, text: text }, scope: sheetScope() }, true);
    }, function () {
      said.textContent = "The file cannot be read.";
    });
  });

  var remove = document.getElementById("sg-sheet-remove");
  if (remove) remove.addEventListener("click", function () { save({ sheet: null, scope: sheetScope() }, true); });

  thresholds.addEventListener("submit", function (event) {
    event.preventDefault();
    var changed = {};
    Array.prototype.forEach.call(thresholds.querySelectorAll("input[type=number]"), function (field) {
      if (field.value !== "" && Number(field.value) !== Number(field.getAttribute("data-default"))) {
        changed[field.name] = Number(field.value);
      }
    });
    save({ thresholds: changed, scope: page.getAttribute("data-scope") }, true);
  });

  document.getElementById("sg-find").addEventListener("input", function (event) {
    var words = event.target.value.toLowerCase().split(/\s+/);
    Array.prototype.forEach.call(thresholds.querySelectorAll("tbody tr"), function (row) {
      var text = row.textContent.toLowerCase();
      row.hidden = !words.every(function (word) { return text.indexOf(word) >= 0; });
    });
  });
})(window.sensorgate);
