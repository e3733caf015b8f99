/* Hooks into WebODM's dashboard. WebODM puts this file into every page, so the rest is fetched when a hook is used.
   The plugin's name is that of its folder: it is read from this script's own address. */
(function () {
  "use strict";

  var sensorgate = (window.sensorgate = window.sensorgate || {});
  var script = document.currentScript;
  var address = script ? new URL(script.src, window.location.href) : null;
  if (!address || sensorgate.base || !window.PluginsAPI || !window.PluginsAPI.Dashboard) return;

  var BASE = ["dom.js", "requests.js"];
  var PARTS = {
    notice: BASE.concat("notice.js"),
    panel: BASE.concat("headers.js", "others.js", "check.js", "upload.js", "dock.js", "verdict.js", "panel.js"),
    task: BASE.concat("dock.js", "task.js")
  };
  var FORMS = ".new-task-panel, .edit-task-panel, .import-task-panel, .import-external-panel, .upload-progress-bar";

  sensorgate.base = address.pathname.replace(/[^/]*$/, "");
  sensorgate.api = sensorgate.base.replace(/\/plugins\/([^/]+)\/$/, "/api/plugins/$1/");
  // What WebODM tells of a project when it draws it: {project id: called when tasks were added}.
  sensorgate.taskAdded = {};

  /* Have WebODM read a project's tasks anew. That closes its forms: not while somebody fills one in. */
  sensorgate.refresh = function (project, item) {
    if (!sensorgate.taskAdded[project] || item.querySelector(FORMS)) return;
    // A row keeps what it knew of its task as long as its list is open: the list is closed and opened.
    var toggle = item.querySelector(".task-list") && item.querySelector(".project-links .fa-tasks + a");
    if (toggle) [1, 2].forEach(function () { toggle.click(); });
    sensorgate.taskAdded[project]();
  };

  var fetched = {};

  /* Fetch scripts one after the other, each of them once. */
  function load(parts) {
    return parts.reduce(function (before, part) {
      return before.then(function () {
        if (!fetched[part]) {
          fetched[part] = fetchScript(sensorgate.base + part + address.search);
          fetched[part].catch(function () { delete fetched[part]; });
        }
        return fetched[part];
      });
    }, Promise.resolve());
  }

  function fetchScript(source) {
    return new Promise(function (resolve, reject) {
      var element = document.createElement("script");
      element.src = source;
      element.onload = resolve;
      element.onerror = function () { reject(new Error(source + " could not be loaded.")); };
      document.head.appendChild(element);
    });
  }

  /* A React component that is an empty element, filled by `mount(element, props)` -> {update(props), close()} out of
     `parts`; `failed` is said where these cannot be fetched. */
  function component(parts, mount, failed) {
    return class extends window.React.Component {
      constructor(props) {
        super(props);
        this.hold = this.hold.bind(this);
        this.element = null;
        this.view = null;
        this.closed = false;
      }
      hold(element) {
        if (element) this.element = element;
      }
      componentDidMount() {
        var self = this;
        load(parts).then(function () {
          if (!self.closed) self.view = mount(self.element, self.props);
        }, function () {
          self.element.textContent = failed;
        });
      }
      componentDidUpdate() {
        if (this.view) this.view.update(this.props);
      }
      componentWillUnmount() {
        this.closed = true;
        if (this.view) this.view.close();
        this.view = null;
      }
      shouldComponentUpdate() {
        return true;
      }
      render() {
        return window.React.createElement("div", { ref: this.hold });
      }
    };
  }

  var MISSING = "The camera check could not be loaded. Reload the page; uploading works without it.";
  var panel = component(PARTS.panel, function (element, props) { return sensorgate.openPanel(element, props); }, MISSING);
  var taskView = component(PARTS.task, function (element, props) { return sensorgate.openTask(element, props); }, MISSING);
  var notice = component(PARTS.notice, function (element, props) { return sensorgate.openNotice(element, props); }, "");
  var dashboard = window.PluginsAPI.Dashboard;

  dashboard.addNewTaskPanelItem(function () { return panel; });
  // No button: it tells the panel, further down in the same project, which project it is in, and watches its tasks.
  dashboard.addNewTaskButton(function (args) {
    sensorgate.taskAdded[args.projectId] = args.onNewTaskAdded;
    return window.React.createElement("span", { hidden: true, "data-sensorgate-project": args.projectId },
      window.React.createElement(notice, { projectId: args.projectId }));
  });
  dashboard.addTaskActionButton(function (args) {
    return window.React.createElement(taskView, { task: args.task });
  });
})();
