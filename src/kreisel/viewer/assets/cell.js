(() => {
const box = document.getElementById($name), page = $page, mark = $mark, lost = $lost, version = $version;
const begun = Date.now();
const show = () => {
  const library = window.kreiselLibrary && window.kreiselLibrary[version];
  if (library) {
    const frame = document.createElement("iframe");
    frame.setAttribute("sandbox", $sandbox); frame.title = "Kreisel: view of a run";
    frame.style.cssText = "width:100%;height:660px;border:0"; frame.srcdoc = page.split(mark).join(library);
    box.replaceChildren(frame);
  } else if (Date.now() - begun > 1000 * $wait) box.textContent = lost;
  else setTimeout(show, 100);
};
show();
})();
