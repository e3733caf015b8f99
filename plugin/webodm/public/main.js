/* Hooks into WebODM's dashboard. WebODM puts this file into every page, so the rest is fetched when a hook is used.
   The plugin's name is that of its folder: it is read from this script's own address. */
(function () {
  "use strict";

  var sensorgate = (window.sensorgate = window.sensorgate || {});
  var script = document.currentScript;
  var address = script ? new URL(script.src, window.location.href) : null;
  if (!address || sensorgate.base || !window.PluginsAPI || !window.PluginsAPI.Dashboard) return;

  var PARTS = ["dom.js", "requests.js", "headers.js", "check.js", "upload.js", "dock.js", "verdict.js", "panel.js", "task.js"];

  sensorgate.base = address.pathname.replace(/[^/]*$/, "");
  sensorgate.api = sensorgate.base.replace(/\/plugins\/([^/]+)\/$/, "/api/plugins/$1/");
  // What WebODM tells of a project when it draws it: {project id: called when tasks were added}.
  sensorgate.taskAdded = {};

  var loading = null;
  function load() {
    if (!loading) {
      loading = PARTS.reduce(function (before, part) {
        return before.then(function () { return fetchScript(sensorgate.base + part + address.search); });
      }, Promise.resolve());
      loading.catch(function () { loading = null; });
    }
    return loading;
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

  /* A React component that is an empty element, filled by `mount(element, props)` -> {update(props), close()}. */
  function component(mount) {
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
        load().then(function () {
          if (!self.closed) self.view = mount(self.element, self.props);
        }, function () {
          self.element.textContent = "The camera check could not be loaded. Reload the page; uploading works without it.";
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

  var panel = component(function (element, props) { return sensorgate.openPanel(element, props); });
  var taskView = component(function (element, props) { return sensorgate.openTask(element, props); });
  var dashboard = window.PluginsAPI.Dashboard;

  dashboard.addNewTaskPanelItem(function () { return panel; });
  // No button: the mark that tells the panel, further down in the same project, which project it is in.
  dashboard.addNewTaskButton(function (args) {
    sensorgate.taskAdded[args.projectId] = args.onNewTaskAdded;
    return window.React.createElement("span", { hidden: true, "data-sensorgate-project": args.projectId });
  });
  dashboard.addTaskActionButton(function (args) {
    return window.React.createElement(taskView, { task: args.task });
  });
})();
