// The theme that a reader chose, before anything is drawn. A file, for the server allows no script inside a page.
document.body.dataset.theme = localStorage.getItem("theme") || "auto";
