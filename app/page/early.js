// Runs before viser's own script. A tab without focus must reconnect like any other, and the
// address must be read before viser rewrites it.
"use strict";
document.hasFocus = () => true;
window.telepresence = { hash: location.hash };
document.documentElement.classList.add("tp");
