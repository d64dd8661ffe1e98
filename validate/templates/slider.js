(function () {
  var slider = document.getElementById("slider");
  var input = slider.querySelector("input");
  input.addEventListener("input", function () {
    slider.style.setProperty("--x", input.value + "%");
  });
})();
