/* Requests as WebODM makes them: same origin, session cookie, CSRF token. Every failure is an Error with a sentence
   for the user; `status` 0 is a connection that failed, `retry` whether it is worth trying again. */
(function (sensorgate) {
  "use strict";

  var FIRST_WAIT_MS = 1000;
  var LONGEST_WAIT_MS = 30000;

  function token() {
    var found = /(?:^|;\s*)csrftoken=([^;]*)/.exec(document.cookie);
    return found ? decodeURIComponent(found[1]) : "";
  }

  function failure(request) {
    var detail = "";
    try {
      var answer = JSON.parse(request.responseText);
      detail = Array.isArray(answer) ? answer.join(" ") : answer.detail || answer.error || "";
    } catch (notJson) {
      detail = "";
    }
    var status = request.status;
    var error = new Error(
      typeof detail === "string" && detail ? detail
        : status === 0 ? "The connection to the server was lost."
        : status === 403 ? "You are not allowed to do this, or you were logged out. Reload the page."
        : "The server answered with an error (" + status + ")."
    );
    error.status = status;
    error.retry = status === 0 || status === 408 || status === 429 || status >= 500;
    error.waitMs = 1000 * (parseFloat(request.getResponseHeader("Retry-After")) || 0);
    return error;
  }

  /* One request. `options`: json or form (body), progress(bytes sent), signal. -> promise of the parsed answer. */
  function send(method, url, options) {
    options = options || {};
    return new Promise(function (resolve, reject) {
      if (options.signal && options.signal.stopped) return reject(stopped());
      var request = new XMLHttpRequest();
      request.open(method, url);
      request.setRequestHeader("Accept", "application/json");
      if (method !== "GET") request.setRequestHeader("X-CSRFToken", token());
      if (options.json !== undefined) request.setRequestHeader("Content-Type", "application/json");
      if (options.progress) request.upload.onprogress = function (event) { options.progress(event.loaded); };
      request.onload = function () {
        release();
        if (request.status < 200 || request.status >= 300) return reject(failure(request));
        try {
          resolve(request.responseText ? JSON.parse(request.responseText) : null);
        } catch (notJson) {
          var error = new Error("The server's answer cannot be read. You may have been logged out: reload the page.");
          error.status = request.status;
          reject(error);
        }
      };
      request.onerror = request.ontimeout = function () { release(); reject(failure(request)); };
      request.onabort = function () { release(); reject(stopped()); };
      var release = options.signal ? options.signal.listen(function () { request.abort(); }) : function () {};
      request.send(options.json !== undefined ? JSON.stringify(options.json) : options.form || null);
    });
  }

  /* The same, tried again with growing pauses where that can help. `failed(error, attempt)` hears of each try. */
  function persist(method, url, options, tries, failed) {
    function attempt(number) {
      return send(method, url, options).catch(function (error) {
        if (!error.retry || number >= tries) throw error;
        if (failed) failed(error, number);
        var wait = Math.max(error.waitMs, Math.min(LONGEST_WAIT_MS, FIRST_WAIT_MS * Math.pow(2, number - 1)));
        return pause(wait, options && options.signal).then(function () { return attempt(number + 1); });
      });
    }
    return attempt(1);
  }

  function pause(ms, signal) {
    return new Promise(function (resolve, reject) {
      if (signal && signal.stopped) return reject(stopped());
      var release = function () {};
      var timer = setTimeout(function () { release(); resolve(); }, ms);
      if (signal) release = signal.listen(function () { clearTimeout(timer); reject(stopped()); });
    });
  }

  function stopped() {
    var error = new Error("Stopped.");
    error.stopped = true;
    return error;
  }

  /* Something that can be stopped once, and tells whoever listens. */
  function Signal() {
    this.stopped = false;
    this.listeners = [];
  }
  Signal.prototype.listen = function (listener) {
    var listeners = this.listeners;
    listeners.push(listener);
    return function () {
      var index = listeners.indexOf(listener);
      if (index >= 0) listeners.splice(index, 1);
    };
  };
  Signal.prototype.stop = function () {
    this.stopped = true;
    this.listeners.splice(0).forEach(function (listener) { listener(); });
  };

  sensorgate.requests = { send: send, persist: persist, pause: pause, stopped: stopped, Signal: Signal };
})(window.sensorgate);
